"""Reference heating: film coefficient and recovery enthalpy of a sphere or a flat plate in equilibrium air."""
