"""The running filter: samples in order, gaps and spikes in them, steps, what sensors ought to show, estimates."""
