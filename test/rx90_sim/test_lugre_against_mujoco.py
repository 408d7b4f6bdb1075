"""The friction element against MuJoCo's own: `dcmotor` with `lugre`, one joint, the same torques."""

from __future__ import annotations

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
if not hasattr(mujoco.MjsActuator, "set_to_dcmotor"):
    pytest.skip("this MuJoCo has no dcmotor with LuGre friction", allow_module_level=True)

from benchmarks import mujoco_lugre as bench  # noqa: E402, after the check for MuJoCo
from benchmarks.hybrid_reference import decoupled_setup  # noqa: E402, after the check for MuJoCo
from rx90_emulator.loop.setup import Setup  # noqa: E402, after the check for MuJoCo


@pytest.mark.parametrize("scenario", bench.SCENARIOS, ids=[s.name for s in bench.SCENARIOS])
def test_mujoco_converges_to_the_plant(shipped: Setup, scenario: bench.Scenario) -> None:
    """At the same step both agree to 3 % of the largest value, and 16 times finer MuJoCo is 16 times nearer to us.

    MuJoCo's scheme is of first order, so halving its step halves its distance from the common solution; the
    plant step stays at one step in a tick, and what it misses itself is far below.
    """
    element, period = bench.as_in_mujoco(shipped.friction.elements[0]), shipped.rates.period
    torques = scenario.torques(period)
    ours = bench.run_plant(decoupled_setup(shipped, (element,), bench.INERTIA), torques)
    coarse = np.array(bench.miss(ours, bench.run_mujoco(element, period, torques)))
    fine = np.array(bench.miss(ours, bench.run_mujoco(element, period, torques, 16)))
    largest = np.abs(np.array(ours)).max(axis=1)
    assert np.all(coarse < 0.03 * largest)
    assert np.all(fine < 0.003 * largest)
    assert coarse / fine == pytest.approx(16.0, rel=0.25)
