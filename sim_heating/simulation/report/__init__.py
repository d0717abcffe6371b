"""Pictures, charts and pages of flights and of flight records."""
