"""Deprecated: use `from sim_heating import load_vehicle`; this module goes with the next release."""

import warnings

from sim_heating.inputs.vehicle import *  # noqa: F403
from sim_heating.inputs.vehicle import load_vehicle as load_vehicle

warnings.warn(
    "sim_heating.inputs.vehicle is deprecated and goes with the next release; use `from sim_heating import "
    "load_vehicle`",
    DeprecationWarning,
    stacklevel=2,
)
