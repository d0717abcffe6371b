"""Sources of flight conditions: JSBSim, a built-in entry in three degrees of freedom, FMUs, recordings."""
