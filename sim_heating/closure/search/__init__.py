"""The search for effects that a declared model lacks: candidates, screening, trial fits, ranking."""
