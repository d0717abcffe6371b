"""What tests share: profiles of hypothesis without a deadline, as the first call of a kernel compiles it, a sample of
examples and all of them; a workdir; the order of files and their distribution to processes."""

from __future__ import annotations

import gc
import os
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from sim_heating.base.parallel.threads import core_count, march_threads

# Hundreds of processes import the same modules, some of them 5 s of compilation: it is done once, whatever the user's
# shell says of compiled files.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# There is a process for every core: more threads of linear algebra would wait for each other, at four times the
# processor time. Set before numpy is imported, for this process and those that it starts.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Every search for cyclic garbage goes through the many objects of loaded modules: a seventh of the time of a picture.
gc.set_threshold(50_000)

settings.register_profile("whole", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("sample", settings.get_profile("whole"), max_examples=25)
settings.load_profile("sample")

BEGUN_FIRST = (
    "simulation/test_fmu_export.py",
    "cli/test_outputs.py",
    "live/test_missing.py",
    "closure/test_measured_records.py",
    "benchmarks/test_closure_challenge.py",
    "benchmarks/test_reliability.py",
    "planning/test_optimal_entry.py",
    "closure/test_contradictions.py",
    "closure/test_lamp_records.py",
    "cli/test_process.py",
    "closure/test_close_loop.py",
    "planning/test_plan.py",
    "cli/test_estimate_cli.py",
    "live/test_estimator.py",
    "planning/test_envelope.py",
    "cli/test_cli.py",
    "closure/test_sensor_changes.py",
    "estimation/test_design.py",
    "closure/test_joint_search.py",
    "heating/test_user_effect.py",
    "templates/test_new_vehicle.py",
    "closure/test_flight_changes.py",
    "closure/test_concurrent_updates.py",
    "test_public_face.py",
    "benchmarks/test_coverage.py",
    "campaign/test_campaign.py",
    "benchmarks/test_mutants.py",
    "estimation/test_process_noise.py",
    "closure/test_report.py",
    "benchmarks/test_challenge.py",
    "planning/test_bands.py",
    "base/test_parallel.py",
    "live/test_engine.py",
    "closure/test_table_prior.py",
    "simulation/test_plugin.py",
    "trajectory/test_entry.py",
    "inputs/test_scenarios.py",
    "estimation/test_flight_to_tables.py",
    "closure/test_findings.py",
    "closure/test_declared_transition.py",
    "trajectory/test_fmu_import_faults.py",
    "base/test_kernel_cache.py",
    "campaign/test_figures.py",
    "cli/test_reproduce.py",
    "closure/test_update_tables.py",
    "base/test_processes.py",
    "estimation/test_estimate_bad_input.py",
    "planning/test_dispersion.py",
    "estimation/test_estimator_statistics.py",
    "base/test_results.py",
    "heating/test_ratio_kernel.py",
    "estimation/test_model_error.py",
    "closure/test_update_effects.py",
    "closure/test_wall_changes.py",
    "live/test_hostile_use.py",
    "closure/test_richer_forms.py",
    "trajectory/test_fmu_import.py",
    "trajectory/test_jsbsim.py",
    "estimation/test_remarks.py",
    "test_distributions.py",
    "live/test_ahead.py",
    "closure/test_lagging_thermocouple.py",
    "cli/test_startup.py",
    "benchmarks/test_verification.py",
    "base/test_page.py",
    "closure/test_revision_files.py",
    "formats/test_keys_act.py",
    "simulation/test_fmu_instances.py",
    "closure/test_plain_marches.py",
)
"""Files of tests that take long, longest first, so that all processes end together. The first two compile different
kernels: those of exported libraries, and those of the package itself. The third waits for processes that give way to
all others, and needs little of the processor itself.
"""


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """A process that crashes ends the run: with whole files to each process, a replacement would wait for ever."""
    if hasattr(config.option, "maxworkerrestart"):
        config.option.maxworkerrestart = "0"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Long files first, the others and the tests of each file in their order; tests of pages in a browser and cases
    beyond a sample are thorough."""
    cases: Counter[tuple[Path, str]] = Counter()
    for item in items:
        if item.get_closest_marker("browser"):
            from tests.support.browser import CHROMIUM

            item.add_marker("thorough")
            item.add_marker(pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium, which is not installed"))
        sample = item.get_closest_marker("sample")
        if sample is not None:
            test = (item.path, item.name.partition("[")[0])
            cases[test] += 1
            if cases[test] > sample.args[0]:
                item.add_marker("thorough")
    place = {config.rootpath / "tests" / name: k for k, name in enumerate(BEGUN_FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One process more than there are cores: some tests wait for programs that they start."""
    return core_count() + 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Whole files to each process, in this order: a fixture of a module is then made once."""
    if config.getoption("dist") != "load":  # another way was asked for
        return None
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False
    return LoadFileScheduling(config, log)


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """Beside others for every core, a process shares its work out to no threads and to no copies of itself."""
    with march_threads(1) if "PYTEST_XDIST_WORKER" in os.environ else nullcontext():
        yield


@pytest.fixture
def workdir(flown_records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the files that the module's fixture `flown_records` made, as working directory."""
    shutil.copytree(flown_records, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path
