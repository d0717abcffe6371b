"""Heating of a surface: atmosphere, gas, reference heating, heating ratios, effects, and the balance at the wall."""
