"""One-dimensional conduction through a stack of layers: mesh, finite elements, implicit step, sensitivities."""
