"""The stiff solver that the plant step is judged by, and the judgement on the beginning of the reference line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.accuracy import compare, full_speed, run_plant, scaled, without_rounding
from benchmarks.hybrid_reference import StiffPlant, Work, hybrid_reference
from rx90_emulator.loop.setup import Setup

POSE = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])


@pytest.fixture(scope="module")
def work() -> Work:
    """Return the reference line up to where the arm has come to speed."""
    return Work.load()._replace(duration=1.2)


def test_the_solver_solves_the_paper_s_equations(shipped: Setup, arm_oracle: Any) -> None:
    """Under switched torques it gives what Radau gives for Pinocchio's arm and the equations of the paper."""
    plant = shipped.plant()
    plant.reset(POSE)
    stiff = StiffPlant(shipped, plant)
    want = stiff.y.copy()
    for torque in ([1.2, -0.8, 0.9, 0.3, -0.2, 0.2], [-1.4, 1.0, -0.3, -0.2, 0.3, 0.1]):
        motor = np.array(torque)
        want = arm_oracle.integrate(want, motor, 20 * shipped.rates.period, 1e-10)
        for _ in range(20):
            stiff.step(motor)
    assert np.abs(want[6:12]).max() > 1e-2
    assert stiff.y == pytest.approx(want, abs=1e-8)


def test_second_order_in_the_closed_loop(work: Work) -> None:
    """Without the encoders' rounding the tip's error falls fourfold per halving of the step, from below 0.2 um."""
    fine = work._replace(setup=without_rounding(work.setup))
    exact = hybrid_reference(fine.setup, work.points, work.start, work.duration)
    assert np.abs(exact.v).max() > 0.1
    misses = [compare(work.setup, run_plant(fine, work.start, n), exact) for n in (1, 2, 4)]
    for errors in zip(*((m.tip, m.joints.max(), m.bristles.max()) for m in misses), strict=True):
        assert -np.polyfit(np.log([1, 2, 4]), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.2)
    assert misses[0].tip < 0.2e-6


def test_shipped_encoders_move_the_tip_by_a_count_at_most(work: Work) -> None:
    """With the encoders' rounding the tip stays within the micrometre or so that one encoder count is worth."""
    reference = hybrid_reference(work.setup, work.points, work.start, work.duration)
    assert compare(work.setup, run_plant(work, work.start, 1), reference).tip < 1.5e-6


@pytest.mark.parametrize(("stiffening", "rate"), [(1.0, 5.0), (100.0, 500.0)])
def test_full_joint_speed_is_stable(shipped: Setup, stiffening: float, rate: float) -> None:
    """Coasting from full joint speed, bristles many times faster than the tick, the step follows the solver."""
    found = full_speed(scaled(shipped, c0=stiffening))
    assert found.rate > rate
    assert found.joints < 1e-5
    assert found.torque < 1e-4
