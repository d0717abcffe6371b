"""Verification: what the program computes against exact, published and independently computed values."""
