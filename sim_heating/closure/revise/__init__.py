"""Ratio tables and effects of a vehicle revised from estimates, with the evidence for each revision."""
