"""Missions planned with the tables: studies of dispersions, envelopes and optimal entries."""
