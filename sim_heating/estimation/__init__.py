"""HEATEST: heating derivatives and thermal parameters from thermocouples, with their bounds."""
