"""Candidates of the search, their screening, and the fits of one candidate on top of a model."""
