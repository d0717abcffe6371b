"""Flight records made by a program that shares no mesh, integrator, ratio kernel or effect with sim_heating.

    python -m benchmarks.generator --count 20 --seed 1 --effects all --out out/records

writes record directories and, beside them, answers.toml with what was put into each. What it takes from sim_heating is
the environment that a record declares by name (standard atmosphere, reference heating, equilibrium air), the
materials in aircraft_data and the writing of files. Forms and their sources: README.md.
"""
