"""What goes wrong while a link runs: sensors that fail, and what the model lacks."""
