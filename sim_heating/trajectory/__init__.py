"""Where flight conditions come from: JSBSim, a built-in entry in three degrees of freedom, FMUs, recordings."""
