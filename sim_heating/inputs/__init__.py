"""Declared inputs: vehicles, control points, scenarios, flight records, sensors."""
