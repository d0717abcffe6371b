"""Credibility: what supports a result, factor by factor, and how far it lies from conditions with measured data."""
