"""Where a link publishes its state: a page, lines of JSON for other displays, Prometheus metrics, a running JSBSim.

Each output has `start`, `publish` and `stop`. `publish` returns at once, whatever a reader does: an output holds the
latest state only, and who reads slowly misses states in between.
"""
