"""The six servo loops on one inertia against independent answers; saturation, feed-forward, and the supervision."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from joint_moves import NAMES, ZERO, points

from rx90_common.base.arrays import Array
from rx90_common.base.rates import Rates
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.setup import Setup

MakeServo = Callable[..., Any]
COUPLING = np.eye(6)
COUPLING[5, 4] = 1.0  # motor 6 turns with q5 + q6
JUMP = np.array([0.1, -0.2, 0.3, 0.05, 0.0, -0.1])
KP, KV, KI, INERTIA, BANDWIDTH, PEAK = 40.0, 300.0, 1e5, 2.0, 800.0, 12.0


def step_to(servo: Any, target: Array) -> None:
    servo.controller.trajectory.accept(points([0.0, 1e-3], [target, target], [ZERO, ZERO]), 0, None)


def ramp(servo: Any, speed: Array, seconds: float) -> None:
    times, end = [0.0, seconds, seconds + 0.1], speed * seconds
    rows, rates = [ZERO, end, end + 0.05 * speed], [speed, speed, ZERO]
    servo.controller.trajectory.accept(points(times, rows, rates), 0, None)


def written_loop(
    reference: Callable[[int], tuple[float, float]], ticks: int, rates: Rates, peak: float = math.inf
) -> tuple[Array, Array, int]:
    """Return positions, torques and ticks in saturation of one inertia under the law, written from its description.

    torque = Mn [kv (kp e + dq_r - dq) + ki integral(e)], PI held over the ticks of the position loop, current loop of
    first order behind the torque limit. Conditional integration: the integrator stands still while the amplifier is at
    its limit and the error would drive it further there.
    """
    position = velocity = torque = integral = held = 0.0
    limited, count, period = 0, 0, rates.period
    pole = math.exp(-2 * math.pi * BANDWIDTH * period)
    positions, torques = [], []
    for k in range(ticks):
        target, speed = reference(k // rates.ratio)
        positions.append(position)
        if k % rates.ratio == 0:
            error = target - position
            if error * limited <= 0:
                integral += error * rates.ratio * period
            held = INERTIA * (KV * KP * error + KI * integral)
        asked = held + INERTIA * KV * (speed - velocity)
        limited = 0 if abs(asked) <= peak else int(math.copysign(1, asked))
        count += limited != 0
        torque = pole * torque + (1 - pole) * min(peak, max(-peak, asked))
        torques.append(torque)
        position += velocity * period + torque / INERTIA / 2 * period**2
        velocity += torque / INERTIA * period
    return np.array(positions), np.array(torques), count


@pytest.mark.parametrize("rates", [Rates(), Rates(4000, 4000), Rates(8000, 500)], ids=["4:1", "1:1", "16:1"])
def test_step_response_of_the_sampled_loop(servo: MakeServo, rates: Rates) -> None:
    """The answer to a step equals that of the loop as it is described, at any ratio of rates."""
    loop = servo(rates, inertia=INERTIA)
    step_to(loop, JUMP)
    ticks = rates.base_hz // 5
    got, _ = loop.run(ticks)
    unit, *_ = written_loop(lambda _: (1.0, 0.0), ticks, rates)
    assert got == pytest.approx(np.outer(unit, JUMP), abs=1e-12)


@pytest.mark.parametrize("damped", ["velocity error", "measured velocity"])
def test_ramp_response(servo: MakeServo, damped: str) -> None:
    """A ramp is followed as the sampled loop does, and in the end without position error if D has the set-point's."""
    speed = np.array([0.5, -0.4, 0.3, 0.2, 0.0, 0.1])
    forward = damped == "velocity error"
    loop = servo(inertia=INERTIA, feed_forward={"velocity": forward})
    ramp(loop, speed, 2.0)
    got, _ = loop.run(4000)
    unit, *_ = written_loop(lambda row: (row * 1e-3, float(forward)), 4000, Rates())
    assert got == pytest.approx(np.outer(unit, speed), abs=1e-12)
    if not forward:
        return
    error = loop.controller.state["error"][0]
    assert np.abs(error).max() < 1e-3 * 0.5 / 40  # without the integrator of the loop: dq_r / kp


def test_the_amplifier_slews_no_faster_than_it_can(servo: MakeServo) -> None:
    """A large change of current runs at the slew rate, then settles by the lag; the torque is k_t i."""
    loop = servo(current_loop={"slew_rate": np.full(6, 8000.0)})
    controller, rest = loop.controller, np.zeros(6)
    controller.state["feed_forward"][0] = 6.0  # 12 A at 0.5 Nm/A: six ticks of 2 A
    currents = []
    for _ in range(12):
        controller.tick = 1
        controller.step(rest, rest)
        currents.append(controller.state["current"][0].copy())
    gain, current = 1 - math.exp(-2 * math.pi * 800.0 / 4000), 0.0
    for got in currents:
        current += min(2.0, gain * (12.0 - current))
        assert got == pytest.approx(np.full(6, current), rel=1e-12)
    assert currents[1] == pytest.approx(np.full(6, 4.0))
    assert controller.state["command"][0] == pytest.approx(0.5 * currents[-1])


def test_saturation_and_recovery(servo: MakeServo) -> None:
    """A step far beyond the amplifier's limit equals conditional integration, tick by tick, and is counted."""
    loop = servo(inertia=INERTIA, peak=PEAK)
    step_to(loop, 1.0 * np.eye(6)[0])
    got, torques = loop.run(12000)
    want, want_torques, count = written_loop(lambda _: (1.0, 0.0), 12000, Rates(), PEAK)
    assert got[:, 0] == pytest.approx(want, abs=1e-9)
    assert torques[:, 0] == pytest.approx(want_torques, abs=1e-6)
    assert np.abs(torques).max() <= PEAK * (1 + 1e-12)
    assert count > 1000
    assert loop.controller.saturated.tolist() == [count, 0, 0, 0, 0, 0]


def test_the_integrator_has_a_limit(servo: MakeServo) -> None:
    """Under a load beyond its limit the integrator stops there, of either sign, and comes back without delay."""
    for load in (9.0, -9.0):
        loop = servo(inertia=INERTIA, servo={"integrator_limit": np.full(6, 4.0)})
        loop.run(8000, load=load)
        integrator = loop.controller.state["integrator"][0]
        assert np.all(integrator == -math.copysign(4.0, load))
        # What is missing the proportional part gives: 5 Nm over M kv kp.
        error = loop.controller.state["error"][0]
        assert error == pytest.approx(np.full(6, -math.copysign(5.0, load) / (INERTIA * KV * KP)), rel=1e-6)
        loop.run(4, load=-load)
        assert np.all(np.abs(integrator) <= 4.0)


PARTS = {
    "none": {},
    "acceleration": {"acceleration": True},
    "coulomb": {"coulomb": True},
    "viscous": {"viscous": True},
    "all": {"velocity": True, "acceleration": True, "coulomb": True, "viscous": True},
}


@pytest.mark.parametrize("part", PARTS)
def test_each_part_of_the_feed_forward_has_its_switch(shipped: Setup, part: str) -> None:
    """Each switch adds its own torque, by motor, from the set-points alone: inertia, Coulomb, viscous."""
    given = shipped.controller
    switch = given.feed_forward.off().replaced(**PARTS[part])
    controller = dataclasses.replace(shipped, controller=given.replaced(feed_forward=switch)).cs7b()
    goal = [0.5, -0.4, 0.3, 0.6, -0.5, 0.7]
    controller.trajectory.accept(
        TrajectoryPoints.create(NAMES, NAMES, [1.0], [goal], [[0.0] * 6], [[0.0] * 6]), 0, None
    )
    gear = shipped.drives.gear
    for k in range(0, 4000, 4):
        controller.step(np.full(6, 0.3), np.full(6, -2.0))  # what is measured does not matter to it
        for _ in range(3):
            controller.step(np.zeros(6), np.zeros(6))
        # The derivative of 10 s^3 - 15 s^4 + 6 s^5, and its change until the next set-point.
        s = np.array([k, k + 4]) / 4000
        # Motor 6 is seen from its own gear's output, which turns with q5 + q6.
        rate, later = np.outer(30 * s**2 - 60 * s**3 + 30 * s**4, COUPLING @ goal)
        acceleration = (later - rate) / 1e-3
        sign = np.clip(rate / given.feed_forward.coulomb_velocity, -1.0, 1.0)
        want = (
            switch.acceleration * given.inertia * acceleration
            + switch.coulomb * np.array(switch.coulomb_torque) * sign
            + switch.viscous * np.array(switch.viscous_friction) * rate
        )
        assert controller.state["feed_forward"][0] * gear == pytest.approx(want, abs=1e-9)
    joint = COUPLING.T @ want
    assert controller.reference()[2] == pytest.approx(joint, abs=1e-9)


def test_gains_are_given_for_the_joint_and_used_at_the_motor(shipped: Setup) -> None:
    """The torque at the gear's output is Mn [kv (kp e + dq_r - dq) + ki T sum(e)] of the gear's own angle."""
    law, given = shipped.cs7b(), shipped.controller
    rng, gear = np.random.default_rng(12), shipped.drives.gear
    error, rate = rng.uniform(-1e-4, 1e-4, 6), rng.uniform(-1e-3, 1e-3, 6)
    law.step(-error * gear, rate * gear)
    kp, kv, ki = np.array([given.servo.kp, given.servo.kv, given.servo.ki])
    pi = given.inertia * (kv * kp + ki * 1e-3) * error
    damping = -given.inertia * kv * rate
    gain = 1 - math.exp(-2 * math.pi * given.current_loop.bandwidth / 4000)
    assert law.state["position_torque"][0] * gear == pytest.approx(pi, rel=1e-12)
    assert law.state["command"][0] * gear == pytest.approx(gain * (pi + damping), rel=1e-9)
    at_joint = law.tracking_error()
    assert at_joint[0] == pytest.approx(np.linalg.solve(COUPLING, error), rel=1e-9)
    assert at_joint[1] == pytest.approx(-np.linalg.solve(COUPLING, rate), rel=1e-9)
    assert at_joint[2] == pytest.approx(COUPLING.T @ (gain * (pi + damping)), rel=1e-9)


def test_reset_discharges_everything(servo: MakeServo) -> None:
    """After a reset the law's state is that of a new controller, and the measured position is held."""
    loop = servo(inertia=INERTIA, peak=PEAK)
    fresh = loop.controller.state.copy()
    step_to(loop, 1.0 * np.eye(6)[0])
    loop.run(100)
    assert not np.array_equal(loop.controller.state, fresh)
    here = np.array([0.5, 0.4, 0.3, 0.2, 0.1, 0.7])
    loop.controller.reset(here, tick=8)
    assert np.array_equal(loop.controller.state, fresh)
    assert loop.controller.position_tick == 2
    assert np.all(loop.controller.step(here, np.zeros(6)) == pytest.approx(np.zeros(6), abs=1e-9))
    assert loop.controller.reference()[0] == pytest.approx([0.5, 0.4, 0.3, 0.2, 0.1, 0.6])


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
    assert (fault.joint, fault.quantity) == (f"joint_{joint + 1}", quantity)
    assert fault.limit == pytest.approx(limit)
    # The error is the set-point less the measurement.
    assert fault.value == pytest.approx(1.001 * limit * (-sign if quantity == "following error" else sign))
    assert fault.time == 12 * 250e-6
    controller.reset(np.zeros(6))
    assert controller.fault is None
