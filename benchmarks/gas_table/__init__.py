"""The table of equilibrium air that ships with the package: how its columns are computed, from published data."""
