"""Dispersed entries: sampled flights, their peak temperatures, and statistics of those."""
