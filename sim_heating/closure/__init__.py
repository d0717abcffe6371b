"""Closing the loop: the effect that a declared model lacks, the evidence for it, revised tables of the vehicle."""
