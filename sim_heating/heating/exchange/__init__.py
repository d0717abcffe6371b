"""Ratio tables in the formats of other programs: DAVE-ML, JSBSim, netCDF, body points of flow solvers."""
