"""Trajectories from an imported FMU, stepped in a separate process."""
