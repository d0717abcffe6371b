"""Statistics of a fit: likelihood, Newton-Raphson, bounds, identifiability, residual tests."""
