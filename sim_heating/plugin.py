"""Deprecated: use `from sim_heating import HeatingPlugin`; this module goes with the next release."""

from sim_heating.base.deprecation import moved_module

__getattr__ = moved_module(__name__, "sim_heating.simulation.plugin", "HeatingPlugin")
