"""What a residual indicates: heating histories, correlations, shapes, hysteresis, axial force."""
