"""Manoeuvres designed for what they would tell of the parameters, before anyone flies them."""
