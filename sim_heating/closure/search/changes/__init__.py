"""Changes of the record as hypotheses: its flight, its wall or its sensors are other than declared."""
