"""Platforms of exported FMUs: a C compiler of this machine links for the platform that runs, and for no other."""

from __future__ import annotations

import llvmlite.binding as llvm
import pytest

from sim_heating.simulation.fmu_export.export import native_platform
from sim_heating.simulation.fmu_export.parts.library import TARGETS

RUNNING = {
    "linux": "x86_64-unknown-linux-gnu",
    "linux-arm64": "aarch64-unknown-linux-gnu",
    "windows": "x86_64-pc-windows-msvc",
    "macos": "x86_64-apple-darwin23.6.0",
    "macos-arm64": "arm64-apple-darwin24.1.0",
}
"""Platform -> the name that LLVM gives it when it runs there."""


@pytest.mark.parametrize("running", RUNNING)
def test_only_the_platform_that_runs_is_native(running, monkeypatch):
    monkeypatch.setattr(llvm, "get_process_triple", lambda: RUNNING[running])
    assert [name for name, target in TARGETS.items() if target.native] == [running]
    assert native_platform() == running
