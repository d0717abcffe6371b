"""Envelopes: boundaries and maps of what can be flown within temperature limits."""
