"""What tests share: analytic solutions, walls and flights to heat, FMUs and hosts to build."""
