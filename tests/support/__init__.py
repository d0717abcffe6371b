"""Support of the tests: analytic solutions, walls and flights to heat, FMUs and hosts to build."""
