"""Evidence from a residual: heating histories, correlations, shapes, hysteresis, axial force."""
