"""Closing the loop: what a declared model lacks, in one record or in several, the evidence for it, revised tables."""
