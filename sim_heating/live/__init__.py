"""A link to a flight that is being flown: what is measured, estimated and ahead, as the samples come in."""
