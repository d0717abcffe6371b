"""Closing the loop: the effect that a declared model lacks, the evidence for it, and revised tables of the vehicle."""
