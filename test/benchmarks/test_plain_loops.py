"""The plain loops of the benchmark are an independent answer to what the kernels with lanes compute."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from unchecked import unchecked

from benchmarks.closed_loop import Ticks
from benchmarks.hybrid_reference import Work
from benchmarks.plain_loops import WORKSPACE_DTYPE, mass_and_bias, run_lanes, run_plain
from rx90_common import arm_dynamics
from rx90_emulator.loop.setup import Setup


@pytest.fixture(scope="module")
def work() -> Work:
    """Return the reference line."""
    return Work.load()


def sensitive(work: Work) -> Work:
    """Return the line with encoders too fine to magnify rounding and friction that depends on the sign of motion."""
    drives = unchecked(work.setup.drives, encoder={"counts_per_revolution": 2**40})
    elements = tuple(
        e.with_parameters({"tau_c_negative": 0.7 * e.tau_c.negative, "tau_s_negative": 0.8 * e.tau_s.negative})
        for e in work.setup.friction.elements
    )
    friction = dataclasses.replace(work.setup.friction, elements=elements)
    return work._replace(setup=dataclasses.replace(work.setup, drives=drives, friction=friction))


def test_newton_and_euler_find_the_same_arm(shipped: Setup) -> None:
    """Mass matrix and bias torques, from link to link, are those of all links at once, to rounding."""
    plant, workspace = shipped.plant(), np.zeros(1, WORKSPACE_DTYPE)
    rng = np.random.default_rng(3)
    for _ in range(50):
        q = rng.uniform(shipped.robot.lower, shipped.robot.upper)
        v = rng.uniform(-1.0, 1.0, 6) * shipped.robot.max_velocity
        lanes, plain = (np.empty((6, 6)), np.empty(6)), (np.empty((6, 6)), np.empty(6))
        arm_dynamics.mass_and_bias(plant.constants[0]["arm"], plant.state[0]["body"], q, v, *lanes)
        mass_and_bias(plant.constants[0]["arm"], workspace[0], q, v, *plain)
        for ours, other in zip(lanes, plain, strict=True):
            assert np.abs(ours - other).max() < 1e-14 * np.abs(ours).max()


def test_the_line_is_the_same_to_rounding(work: Work) -> None:
    """The joints agree over the whole line to a picoradian."""
    ticks = Ticks(sensitive(work))
    lanes, plain = (ticks.run(kernel)[1] for kernel in (run_lanes, run_plain))
    assert np.ptp(lanes, axis=0).max() > 0.1
    assert np.abs(lanes - plain).max() < 1e-12
