"""Trajectories from an imported FMU, stepped in a process of its own."""
