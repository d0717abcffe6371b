"""Thermal marches: control points along a flight, their temperature histories, and their sensitivities."""
