"""Aerodynamic heating beside a flight simulator: temperatures from a trajectory, heating from temperatures."""
