"""Trajectories from an imported FMU, stepped in a separate process.

The modules that read and step an FMU need FMPy, which a default installation is without; `require_fmpy` is called
before they are imported.
"""

from __future__ import annotations

from importlib.util import find_spec

from sim_heating.base.errors import InputError


def require_fmpy() -> None:
    """Check that FMPy is there.

    raises : InputError, one line, with what to install
    """
    if find_spec("fmpy") is None:
        raise InputError(
            "FMPy, which flies an FMU, is not installed: pip install 'sim-heating[fmu-import]'; or fly with another "
            'source, as `source = "entry-3dof"` in [trajectory]'
        )
