"""The running filter: samples in order, steps, what sensors ought to show, starts and estimates."""
