"""Packages of the extra `live`, or one line where one is missing."""

from __future__ import annotations

from importlib.util import find_spec

from sim_heating.base.errors import InputError


def need_extra(*packages: str) -> None:
    """Refuse to go on without packages of the extra `live`.

    packages : names as they are imported
    raises   : InputError with what to install
    """
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        raise InputError(f"live: {', '.join(missing)} is not installed; pip install 'sim-heating[live]', or '.[live]'")
