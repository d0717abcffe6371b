"""Simulation: runs of scenarios, synthetic records, predictions, the plug-in for a host simulator, and its FMU."""
