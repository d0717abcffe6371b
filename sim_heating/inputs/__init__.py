"""What a user declares: vehicles, control points, scenarios, flight records, sensors."""
