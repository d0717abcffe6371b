"""Flight records made by a program that shares no mesh, integrator, ratio kernel or effect with sim_heating.

    python -m benchmarks.generator --count 20 --seed 1 --effects all --out out/records

writes record directories and, next to them, answers.toml with the effect put into each. Types of deviation and family,
recorder, ratio and materials are those of benchmarks/challenge; flights, walls, mesh and integrator are a second
program, so that the two sets check each other. From sim_heating it takes the environment that a record declares by
name (standard atmosphere, reference heating, equilibrium air) and the writing of
files. Forms and their sources: README.md.
"""
