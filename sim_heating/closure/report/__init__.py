"""Loops over several records: each by itself, or one cause sought in all of them together."""
