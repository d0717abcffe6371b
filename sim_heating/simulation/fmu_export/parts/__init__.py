"""Parts of any FMU: the image of its model, its description, its library of compiled functions, its archive."""
