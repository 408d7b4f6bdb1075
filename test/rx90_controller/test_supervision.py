"""The controller's supervision: following error and speed of each joint, and what the servo loop does about them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rx90_common.base.errors import SupervisionError
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

COUPLING = np.eye(6)
COUPLING[5, 4] = 1.0  # motor 6 turns with q5 + q6
NOMINAL_SPEED = np.deg2rad([236, 200, 286, 401, 320, 580])  # published, rad/s


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("quantity", ["following error", "speed"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_each_joint_has_its_limits(shipped: Setup, joint: int, quantity: str, sign: float) -> None:
    """A joint beyond 0.05 rad or 1.2 times its nominal speed is a fault with its name, value and time; below, none."""
    limit = 0.05 if quantity == "following error" else 1.2 * NOMINAL_SPEED[joint]
    at_motors = shipped.drives.gear * COUPLING[:, joint] * limit * sign
    moved, rest = (at_motors, np.zeros(6)) if quantity == "following error" else (np.zeros(6), at_motors)
    controller = shipped.cs7b()
    controller.reset(np.zeros(6), tick=8)
    controller.step(0.999 * moved, 0.999 * rest)
    assert controller.fault is None
    for _ in range(4):
        controller.step(1.001 * moved, 1.001 * rest)
    fault = controller.fault
    assert fault is not None
    assert (fault.joint, fault.quantity) == (f"joint_{joint + 1}", quantity)
    assert fault.limit == pytest.approx(limit)
    # The error is the set-point less the measurement.
    assert fault.value == pytest.approx(1.001 * limit * (-sign if quantity == "following error" else sign))
    assert fault.time == 12 * 250e-6
    controller.reset(np.zeros(6))
    assert controller.fault is None


def weak(setup: Setup, following_error: float) -> Setup:
    """Return a setup whose motor 2 is too weak for the motion, with another limit of the following error."""
    drives = dataclasses.replace(setup.drives, peak_current=setup.drives.peak_current * [1, 0.15, 1, 1, 1, 1])
    controller = dataclasses.replace(setup.controller, following_error=np.full(6, following_error))
    return dataclasses.replace(setup, drives=drives, controller=controller)


def test_a_run_ends_where_the_error_goes_beyond_its_limit(shipped: Setup) -> None:
    """The closed loop ends with an error in the tick in which the same run without supervision is 0.05 rad off."""
    names, home = shipped.robot.joint_names, np.array([0.1, 0.3, 1.1, -0.2, 0.7, 0.3])
    turn = home + 0.08 * np.array([1, -1, 1, -1, 1, -1])
    points = TrajectoryPoints.create(names, names, [0.0, 0.3, 0.6], [home, turn, home], [[0.0] * 6] * 3, [[]] * 3)
    error = simulate(weak(shipped, 10.0), points).slow.tracking_error[:, 0]
    beyond = np.abs(error) > 0.05
    first = int(np.argmax(beyond.any(axis=1)))
    assert first > 0
    joint = int(np.argmax(beyond[first]))
    with pytest.raises(SupervisionError) as caught:
        simulate(weak(shipped, 0.05), points)
    assert str(caught.value) == (
        f"joint_{joint + 1}: following error {error[first, joint]:.4g} rad at {first / 1000:.6g} s; "
        "accepted: up to 0.05 rad; the controller's supervision has cut the power"
    )
