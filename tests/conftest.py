"""What all tests share: a hypothesis profile without a deadline, as the first call of a kernel compiles it."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

settings.register_profile("compiled", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("compiled")
