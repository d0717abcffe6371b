"""What a declared heating-ratio table says of the parameters of the linear model along a flown path."""
