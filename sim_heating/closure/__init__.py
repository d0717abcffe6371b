"""From what a declared model does not explain to the effect that it lacks (search.py), with the evidence for it."""
