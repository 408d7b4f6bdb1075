"""Saturation, wind-up, the integrator's limit, and each part of the feed-forward."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_controller.law.parameters import FeedForward
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
MakeServo = Callable[..., Any]
NAMES = tuple(f"joint_{i}" for i in range(1, 7))
KP, KV, KI, INERTIA, PEAK = 40.0, 300.0, 1e5, 2.0, 12.0


def jump(servo: Any, size: float) -> None:
    """Give joint 1 a set-point that jumps at the start and stays."""
    row = [size, 0.0, 0.0, 0.0, 0.0, 0.0]
    servo.controller.trajectory.accept(
        TrajectoryPoints.create(NAMES, NAMES, [0.0, 1e-3], [row, row], [[0.0] * 6] * 2, [[], []]), 0, None
    )


def limited_loop(size: float, ticks: int, *, anti_windup: bool) -> tuple[Array, Array, int]:
    """Return positions, torques and ticks in saturation of one inertia under the law with a torque limit.

    Conditional integration: the integrator stands still while the amplifier is at its limit and the error
    would drive it further there.
    """
    position = velocity = torque = integral = held = 0.0
    limited, count, pole = 0, 0, math.exp(-2 * math.pi * 800.0 / 4000)
    positions, torques = [], []
    for k in range(ticks):
        positions.append(position)
        if k % 4 == 0:
            error = size - position
            if not (anti_windup and error * limited > 0):
                integral += error * 1e-3
            held = INERTIA * (KV * KP * error + KI * integral)
        asked = held - INERTIA * KV * velocity
        limited = 0 if abs(asked) <= PEAK else int(math.copysign(1, asked))
        count += limited != 0
        torque = pole * torque + (1 - pole) * min(PEAK, max(-PEAK, asked))
        torques.append(torque)
        position += velocity / 4000 + torque / INERTIA / 2 / 4000**2
        velocity += torque / INERTIA / 4000
    return np.array(positions), np.array(torques), count


def test_saturation_and_recovery(servo: MakeServo) -> None:
    """A step far beyond the amplifier's limit equals conditional integration, tick by tick, and is counted."""
    loop = servo(inertia=INERTIA, peak=PEAK)
    jump(loop, 1.0)
    got, torques = loop.run(12000)
    want, want_torques, count = limited_loop(1.0, 12000, anti_windup=True)
    assert got[:, 0] == pytest.approx(want, abs=1e-9)
    assert torques[:, 0] == pytest.approx(want_torques, abs=1e-6)
    assert np.abs(torques).max() <= PEAK * (1 + 1e-12)
    assert count > 1000
    assert loop.controller.saturated.tolist() == [count, 0, 0, 0, 0, 0]


def test_without_anti_windup_the_same_step_winds_up(servo: MakeServo) -> None:
    """A saturated step comes to rest at its target; with a wound-up integrator it never does."""
    loop = servo(inertia=INERTIA, peak=PEAK)
    jump(loop, 0.2)
    got, _ = loop.run(20000)
    wound, _, _ = limited_loop(0.2, 20000, anti_windup=False)
    assert got[:, 0].max() < 2 * 0.2
    assert np.abs(got[-4000:, 0] - 0.2).max() < 1e-9
    assert np.abs(wound[-4000:] - 0.2).max() > 2 * 0.2


def test_the_integrator_leaves_saturation_at_once(servo: MakeServo) -> None:
    """In saturation an error of the other sign discharges the integrator, one of the same sign stops it."""
    loop = servo(inertia=INERTIA, peak=PEAK)
    controller = loop.controller
    for sign in (1.0, -1.0):
        controller.reset(np.zeros(6))
        state = controller.state[0]
        state["integrator"] = 5.0 * sign
        state["limited"] = int(sign)
        controller.step(np.full(6, -0.01 * sign), np.zeros(6))  # the error has the sign of the limit
        assert np.all(state["integrator"] == 5.0 * sign)
        controller.tick = 4
        state["limited"] = int(sign)
        controller.step(np.full(6, 0.01 * sign), np.zeros(6))
        assert np.all(np.abs(state["integrator"]) < 5.0)


def test_the_integrator_has_a_limit(servo: MakeServo) -> None:
    """Under a load beyond its limit the integrator stops there, of either sign, and comes back without delay."""
    for load in (9.0, -9.0):
        loop = servo(inertia=INERTIA, integrator_limit=np.full(6, 4.0))
        loop.run(8000, load=load)
        integrator = loop.controller.state["integrator"][0]
        assert np.all(integrator == -math.copysign(4.0, load))
        # What is missing the proportional part gives: 5 Nm over M kv kp.
        error = loop.controller.state["error"][0]
        assert error == pytest.approx(np.full(6, -math.copysign(5.0, load) / (INERTIA * KV * KP)), rel=1e-6)
        loop.run(4, load=-load)
        assert np.all(np.abs(integrator) <= 4.0)


PARTS = {
    "none": FeedForward.off(),
    "acceleration": dataclasses.replace(FeedForward.off(), acceleration=True),
    "coulomb": dataclasses.replace(FeedForward.off(), coulomb=True),
    "viscous": dataclasses.replace(FeedForward.off(), viscous=True),
    "all": FeedForward(),
}


@pytest.mark.parametrize("part", PARTS)
def test_each_part_of_the_feed_forward_has_its_switch(shipped: Setup, part: str) -> None:
    """Each switch adds its own torque, by motor, from the set-points alone: inertia, Coulomb, viscous."""
    switch, given = PARTS[part], shipped.controller
    controller = dataclasses.replace(shipped, controller=dataclasses.replace(given, feed_forward=switch)).cs7b()
    goal = [0.5, -0.4, 0.3, 0.6, -0.5, 0.7]
    controller.trajectory.accept(
        TrajectoryPoints.create(NAMES, NAMES, [1.0], [goal], [[0.0] * 6], [[0.0] * 6]), 0, None
    )
    gear, coupling = shipped.drives.gear, np.eye(6)
    coupling[5, 4] = 1.0
    for k in range(0, 4000, 4):
        controller.step(np.full(6, 0.3), np.full(6, -2.0))  # what is measured does not matter to it
        for _ in range(3):
            controller.step(np.zeros(6), np.zeros(6))
        # 10 s^3 - 15 s^4 + 6 s^5 with its derivatives.
        s = k / 4000
        # Motor 6 is seen from its own gear's output, which turns with q5 + q6.
        rate = coupling @ goal * (30 * s**2 - 60 * s**3 + 30 * s**4)
        acceleration = coupling @ goal * (60 * s - 180 * s**2 + 120 * s**3)
        sign = np.clip(rate / given.coulomb_velocity, -1.0, 1.0)
        want = (
            switch.acceleration * given.inertia * acceleration
            + switch.coulomb * given.coulomb * sign
            + switch.viscous * given.viscous * rate
        )
        assert controller.state["feed_forward"][0] * gear == pytest.approx(want, abs=1e-9)
    joint = coupling.T @ want
    assert controller.reference()[2] == pytest.approx(joint, abs=1e-9)


def test_gains_are_given_for_the_joint_and_used_at_the_motor(shipped: Setup) -> None:
    """The torque at the gear's output is Mn [kv (kp e + dq_r - dq) + ki T sum(e)] of the gear's own angle."""
    law, given = shipped.cs7b(), shipped.controller
    rng, gear = np.random.default_rng(12), shipped.drives.gear
    error, rate = rng.uniform(-1e-4, 1e-4, 6), rng.uniform(-1e-3, 1e-3, 6)
    law.step(-error * gear, rate * gear)
    coupling = np.eye(6)
    coupling[5, 4] = 1.0
    pi = given.inertia * (given.kv * given.kp + given.ki * 1e-3) * error
    damping = -given.inertia * given.kv * rate
    gain = 1 - math.exp(-2 * math.pi * given.current_bandwidth / 4000)
    assert law.state["position_torque"][0] * gear == pytest.approx(pi, rel=1e-12)
    assert law.state["command"][0] * gear == pytest.approx(gain * (pi + damping), rel=1e-9)
    at_joint = law.tracking_error()
    assert at_joint[0] == pytest.approx(np.linalg.solve(coupling, error), rel=1e-9)
    assert at_joint[1] == pytest.approx(-np.linalg.solve(coupling, rate), rel=1e-9)
    assert at_joint[2] == pytest.approx(coupling.T @ (gain * (pi + damping)), rel=1e-9)


def test_reset_discharges_everything(servo: MakeServo) -> None:
    """After a reset the law's state is that of a new controller, and the measured position is held."""
    loop = servo(inertia=INERTIA, peak=PEAK)
    fresh = loop.controller.state.copy()
    jump(loop, 1.0)
    loop.run(100)
    assert not np.array_equal(loop.controller.state, fresh)
    here = np.array([0.5, 0.4, 0.3, 0.2, 0.1, 0.7])
    loop.controller.reset(here, tick=8)
    assert np.array_equal(loop.controller.state, fresh)
    assert loop.controller.position_tick == 2
    assert np.all(loop.controller.step(here, np.zeros(6)) == pytest.approx(np.zeros(6), abs=1e-9))
    assert loop.controller.reference()[0] == pytest.approx([0.5, 0.4, 0.3, 0.2, 0.1, 0.6])
