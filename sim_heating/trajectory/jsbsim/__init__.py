"""Trajectories from JSBSim: the vehicle's model, its pilot, and the host."""
