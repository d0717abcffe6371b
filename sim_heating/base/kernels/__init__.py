"""How kernels are compiled, the layout of their data, and elementary functions with the same bits everywhere."""
