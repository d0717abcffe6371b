"""The package `jsbsim`, or one clear line where it is missing: some platforms have no wheel of it.

Everything else of the program works without it; modules that import this one are imported when they are used.
"""

from __future__ import annotations

from sim_heating.base.errors import InputError

try:
    import jsbsim as jsbsim
except ImportError as error:
    is_missing = isinstance(error, ModuleNotFoundError) and error.name == "jsbsim"
    reason = "is not installed" if is_missing else f"cannot be loaded ({' '.join(str(error).split())})"
    raise InputError(
        f"JSBSim {reason}: pip install 'sim-heating[jsbsim]', which compiles it where there is no wheel for this "
        'platform; or fly with another source, as `source = "entry-3dof"` in [trajectory]'
    ) from None
