"""Where flight conditions come from: JSBSim, a built-in entry in three degrees of freedom, an FMU, a recorded flight."""
