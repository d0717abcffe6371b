"""The kernel as plain Python is its own slow reference: interpreted and compiled give the same bits."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from sim_heating.heating.effects import use
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from tests.support.paths import ROOT
from tests.support.walls import flight, material, practice_model, wall

FEW_STEPS_S = np.array([0.0, 0.5, 1.7, 2.7, 2.8])


def everything() -> Ensemble:
    """Three points that have a table, effects, pressure columns, two gas models, a contact and a cooled back in all."""
    catalytic = (use("catalysis"), use("transition", {"log10_re_onset": 5.0}))
    pushed = (use("impingement-onset"), use("jet-interaction"))
    outer, back = material(emissivity=0.8), {"h_W_m2K": 9.0, "T_K": 280.0}
    cooled = wall((outer, 0.01), (material(2.0), 0.01), contact=1e-3, back=back)
    curved = {"ratio.d0": 0.4, "ratio.d_alpha2": 1e-4, "ratio.d_alpha_elevon": -2e-4}
    return pack(
        [
            practice_model("p06", nodes=14, effects=catalytic),
            practice_model("p07", nodes=14, effects=pushed, wall_enthalpy="equilibrium-air"),
            PointModel("cooled", cooled, (0.002,), nodes=14, parameters=curved, reference=(38.0, 0.0, 5.0, 1.0, 2.0)),
        ]
    )


def some_flight() -> np.ndarray:
    """A history in which every condition that the kernel reads changes."""
    t = FEW_STEPS_S
    angles = {"alpha_deg": 38.0 + 2.0 * t, "beta_deg": -0.5 * t, "elevon_deg": t, "bodyflap_deg": 8.0 - t}
    flow = {"log10_re": 4.9 + 0.1 * t, "p_surface_Pa": 30.0 * 10.0**t, "h_ref_kg_m2_s": 0.01 + 0.02 * t}
    return flight(t, H_r_J_kg=2.5e7 - 1e5 * t, q_add_W_m2=1e3 * t, jets=0.2 * t, mach=20.0 - t, **angles, **flow)


def state_in_hex() -> list[str]:
    """Every node temperature after each step, exactly."""
    ensemble, history, lines = everything(), some_flight(), []
    for k in range(1, len(FEW_STEPS_S)):
        # two samples are one step, whatever its length; the march begins again from the temperatures present
        ensemble.march(FEW_STEPS_S[k - 1 : k + 1], history[:, k - 1 : k + 1], [0, 0, 0], longest_step_s=10.0)
        lines += [float(T).hex() for i in range(3) for T in ensemble.node_temperatures(i)]
    counts = (*ensemble.counters.iterations, *ensemble.counters.steps)
    return [*lines, *(float(n).hex() for n in counts)]


def run_interpreted(code: str) -> str:
    """Output of Python code with nothing compiled, tests and package importable."""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="compares with the compiled kernel")
def test_interpreted_and_compiled_steps_agree_bit_for_bit():
    interpreted = run_interpreted(
        "import tests.march.test_kernel_interpreted as t; print('\\n'.join(t.state_in_hex()))"
    ).split()
    assert interpreted == state_in_hex()


def test_every_point_of_the_comparison_is_heated():
    ensemble = everything()
    start = [ensemble.node_temperatures(i)[0] for i in range(3)]
    ensemble.march(FEW_STEPS_S, some_flight(), [0, 0, 0])
    assert all(ensemble.node_temperatures(i)[0] > start[i] + 10.0 for i in range(3))
    assert len(set(ensemble.counters.steps)) == 3  # each divides its steps in its own way
