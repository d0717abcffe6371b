"""Entries of largest cross-range below temperature limits, by collocation."""
