"""Models as FMUs (co-simulation units of the Functional Mock-up Interface) that need no Python where they run."""
