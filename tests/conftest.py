"""What all tests share: a hypothesis profile, since the first call of a compiled kernel takes seconds; the project's folders."""

from __future__ import annotations

from pathlib import Path

from hypothesis import HealthCheck, settings

settings.register_profile("compiled", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("compiled")

ROOT = Path(__file__).resolve().parent.parent
SCENARIOS = ROOT / "scenarios"
