"""The six servo loops on a single inertia: step, ramp, current loop, each against an independent answer.

Joint 5 stays at rest wherever joint 6 is looked at, because motor 6 follows q5 + q6.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from rx90_common.base.rates import Rates
from rx90_controller.law.parameters import FeedForward
from rx90_controller.trajectory import TrajectoryPoints

Array = NDArray[np.float64]
MakeServo = Callable[..., Any]
NAMES = tuple(f"joint_{i}" for i in range(1, 7))
JUMP = np.array([0.1, -0.2, 0.3, 0.05, 0.0, -0.1])
KP, KV, KI, INERTIA, BANDWIDTH = 40.0, 300.0, 1e5, 2.0, 800.0


def step_to(servo: Any, target: Array) -> None:
    """Give a set-point that jumps at the start and stays."""
    rows, rest = [target, target], [[0.0] * 6] * 2
    servo.controller.trajectory.accept(
        TrajectoryPoints.create(NAMES, NAMES, [0.0, 1e-3], rows, rest, [[], []]), 0, None
    )


def ramp(servo: Any, speed: Array, seconds: float) -> None:
    """Give a set-point that runs at constant speed."""
    times, end = [0.0, seconds, seconds + 0.1], speed * seconds
    rows, rates = [[0.0] * 6, end, end + 0.05 * speed], [speed, speed, [0.0] * 6]
    servo.controller.trajectory.accept(TrajectoryPoints.create(NAMES, NAMES, times, rows, rates, [[]] * 3), 0, None)


def sampled_loop(reference: Callable[[int], tuple[float, float]], ticks: int, ratio: int, period: float) -> Array:
    """Return positions of one inertia under the law, by matrices written from its description.

    torque = Mn [kv (kp e + dq_r - dq) + ki integral(e)], PI held over `ratio` ticks, current loop of first order.
    The inertia by the matrix exponential of a double integrator, the current loop by its sampled pole.
    """
    plant = signal.cont2discrete((np.eye(2, k=1), np.array([[0], [1 / INERTIA]]), np.eye(2), np.zeros((2, 1))), period)
    a, b = plant[0], plant[1][:, 0]
    pole = math.exp(-2 * math.pi * BANDWIDTH * period)
    state, torque, integral, held = np.zeros(2), 0.0, 0.0, 0.0
    positions = []
    for k in range(ticks):
        target, speed = reference(k // ratio)
        if k % ratio == 0:
            error = target - state[0]
            integral += error * ratio * period
            held = INERTIA * (KV * KP * error + KI * integral)
        asked = held + INERTIA * KV * (speed - state[1])
        torque = pole * torque + (1 - pole) * asked
        positions.append(state[0])
        state = a @ state + b * torque
    return np.array(positions)


@pytest.mark.parametrize("rates", [Rates(), Rates(4000, 4000), Rates(8000, 500)], ids=["4:1", "1:1", "16:1"])
def test_step_response_of_the_sampled_loop(servo: MakeServo, rates: Rates) -> None:
    """The answer to a step equals that of the sampled loop written as matrices, at any ratio of rates."""
    loop = servo(rates, inertia=INERTIA)
    step_to(loop, JUMP)
    ticks = rates.base_hz // 5
    got, _ = loop.run(ticks)
    unit = sampled_loop(lambda _: (1.0, 0.0), ticks, rates.ratio, rates.period)
    assert got == pytest.approx(np.outer(unit, JUMP), abs=1e-12)


def test_step_response_tends_to_the_continuous_transfer_function(servo: MakeServo) -> None:
    """With growing rates the answer tends, with order 1, to that of the continuous loop by SciPy."""
    # q / q_r of M s^2 q = lag(s) M [kv (kp e - s q) + ki e / s], e = q_r - q, lag = 1 / (s / w + 1).
    w = 2 * math.pi * BANDWIDTH
    system = signal.lti([KV * KP, KI], [1 / w, 1.0, KV, KV * KP, KI])
    errors = []
    for base in (8000, 16000, 32000):
        loop = servo(Rates(base, base // 4), inertia=INERTIA)
        step_to(loop, JUMP)
        ticks = base // 10
        got, _ = loop.run(ticks)
        _, want = signal.step(system, T=np.arange(ticks) / base)
        errors.append(np.abs(got[:, 0] / JUMP[0] - want).max())
    assert errors[0] < 0.1
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([1.0, 1.0], abs=0.2)


def test_ramp_response(servo: MakeServo) -> None:
    """A ramp is followed as the sampled loop does, and in the end without position error."""
    speed = np.array([0.5, -0.4, 0.3, 0.2, 0.0, 0.1])
    loop = servo(inertia=INERTIA)
    ramp(loop, speed, 2.0)
    got, _ = loop.run(4000)
    unit = sampled_loop(lambda row: (row * 1e-3, 1.0), 4000, 4, 250e-6)
    assert got == pytest.approx(np.outer(unit, speed), abs=1e-12)
    error = loop.controller.state["error"][0]
    assert np.abs(error).max() < 1e-3 * 0.5 / 40  # without the integrator of the loop: dq_r / kp


def test_without_the_velocity_set_point_d_damps_the_motion_itself(servo: MakeServo) -> None:
    """With D on the measured velocity alone a ramp is answered as the sampled loop with no velocity input does."""
    loop = servo(inertia=INERTIA, feed_forward=FeedForward.off())
    speed = np.array([0.5, -0.4, 0.3, 0.2, 0.0, 0.1])
    ramp(loop, speed, 2.0)
    got, _ = loop.run(4000)
    unit = sampled_loop(lambda row: (row * 1e-3, 0.0), 4000, 4, 250e-6)
    assert got == pytest.approx(np.outer(unit, speed), abs=1e-12)


def test_the_integrator_takes_a_constant_load(servo: MakeServo) -> None:
    """Under a constant load torque the position error dies out and the integrator gives the load."""
    loop = servo(inertia=INERTIA)
    positions, torques = loop.run(8000, load=-7.0)
    assert np.abs(positions).max() > 1e-5
    assert np.abs(positions[-1]).max() < 1e-9
    assert torques[-1] == pytest.approx(np.full(6, 7.0), rel=1e-6)
    assert loop.controller.state["integrator"][0] == pytest.approx(np.full(6, 7.0), rel=1e-6)


def test_the_current_loop_is_a_sampled_lag_of_its_bandwidth(servo: MakeServo) -> None:
    """A step of the asked current is answered as a lag of first order, 1 - exp(-2 pi f t), sampled."""
    loop = servo(kv=np.zeros(6), ki=np.full(6, 1e-9), inertia=1e9, current_bandwidth=150.0)
    controller = loop.controller
    controller.state["feed_forward"][0] = 3.0
    controller.tick = 1  # no position tick before the fourth
    got = [controller.step(np.zeros(6), np.zeros(6)).copy() for _ in range(3)]
    controller.tick = 1
    got += [controller.step(np.zeros(6), np.zeros(6)).copy() for _ in range(3)]
    times = (np.arange(6) + 1) / 4000
    want = 3.0 * (1 - np.exp(-2 * math.pi * 150.0 * times))
    assert np.array(got) == pytest.approx(np.repeat(want[:, None], 6, axis=1), rel=1e-12)


def test_the_amplifier_slews_no_faster_than_it_can(servo: MakeServo) -> None:
    """A large change of current runs at the slew rate, then settles by the lag; the torque is k_t i."""
    loop = servo(current_slew=np.full(6, 8000.0))
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


def test_pi_and_feed_forward_run_on_every_fourth_tick_only(servo: MakeServo) -> None:
    """Between position ticks PI and FF torques are held, while velocity feedback and current go on."""
    loop = servo(viscous=np.full(6, 3.0), feed_forward=FeedForward())
    rows, rest = [[0.3] * 6], [[0.0] * 6]
    loop.controller.trajectory.accept(TrajectoryPoints.create(NAMES, NAMES, [0.5], rows, rest, [[]]), 0, None)
    held, moving = [], []
    for _ in range(400):
        loop.run(1)
        state = loop.controller.state[0]
        held.append(np.concatenate([state["position_torque"], state["feed_forward"], state["error"]]))
        moving.append(state["command"].copy())
    changes = np.any(np.diff(held, axis=0) != 0.0, axis=1)
    ticks = np.arange(1, 400)
    assert np.array_equal(changes, ticks % 4 == 0)
    assert np.all(np.any(np.diff(moving, axis=0) != 0.0, axis=1)[8:])
