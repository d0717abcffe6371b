"""Equilibrium air, computed from published data by other programs."""
