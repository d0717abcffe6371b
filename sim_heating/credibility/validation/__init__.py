"""Validation: the conditions that measured data sets cover, and data sets of a user."""
