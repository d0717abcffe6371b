"""What tests share: a hypothesis profile without a deadline, as the first call of a kernel compiles it; a workdir."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("compiled", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("compiled")


@pytest.fixture
def workdir(flown_records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the files that the module's fixture `flown_records` made, as working directory."""
    shutil.copytree(flown_records, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path
