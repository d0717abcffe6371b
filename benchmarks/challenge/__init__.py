"""A second, harder set of flight records with known truth, made without any code of sim_heating.

    python -m benchmarks.challenge --count 66 --seed 1 --classes all --out out/challenge --processes 2

writes record directories and, next to them, answers.toml. Flights follow the shipped scenarios, control points and
materials are those of aircraft_data, read as data. Only flown.py, which makes the package's own flights, imports the
package. Classes, forms and their equations: README.md.
"""
