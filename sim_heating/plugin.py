"""Deprecated: use `from sim_heating import HeatingPlugin`; this module goes with the next release."""

import warnings

from sim_heating.simulation.plugin import *  # noqa: F403
from sim_heating.simulation.plugin import HeatingPlugin as HeatingPlugin

warnings.warn(
    "sim_heating.simulation.plugin is deprecated and goes with the next release; use `from sim_heating import "
    "HeatingPlugin`",
    DeprecationWarning,
    stacklevel=2,
)
