"""Heating ratios: tables, their lookup, scaling from the wind tunnel to flight, uncertainty."""
