"""What commands that come late do to the loop: margins of the linear loop, and runs of plant and law without ROS.

    python -m benchmarks.command_delay

The table has a row for each delay in base ticks. The linear loop is one servo motor with its nominal inertia and
nothing else: PI at the position rate, D, current loop and velocity observer at the base rate, written here as
difference equations. Its spectral radius over a tick of the position loop tells how fast a deviation dies away, below
1, or grows. The runs are those of the whole robot along a motion of all joints with 0.75 rad/s; once every command is
late by as many ticks, and once as many ticks share one command, as when the two nodes take turns on a processor.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.report import print_table
from rx90_common.base.arrays import Array
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.setup import Setup

DELAYS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 16)
HOME = np.array([0.1, 0.3, 1.1, -0.2, 0.7, 0.3])
TURN = 0.5 * np.array([1.0, -0.5, 0.8, 1.0, -1.0, 1.0])
SECONDS = 4


class Loop(NamedTuple):
    """One linear servo motor on a unit inertia: gains and periods.

    Attributes:
        kp: 1/s.
        kv: 1/s.
        ki: 1/s^3.
        period: of the base tick, s.
        ratio: base ticks in a tick of the position loop.
        current_gain: of the current loop in a tick.
        pole: of the velocity observer.
    """

    kp: float
    kv: float
    ki: float
    period: float
    ratio: int
    current_gain: float
    pole: float

    @classmethod
    def of(cls, setup: Setup) -> Loop:
        """Return the loop of motor 1; the shipped gains are alike for all six."""
        controller, rates = setup.controller, setup.rates
        return cls(
            *(
                float(gain[0])
                for gain in (controller.servo.kp, controller.servo.kv, controller.servo.ki)
            ),
            rates.period,
            rates.ratio,
            -np.expm1(-2.0 * np.pi * controller.current_loop.bandwidth * rates.period),
            float(np.exp(-2.0 * np.pi * setup.drives.velocity_bandwidth * rates.period)),
        )


def spectral_radius(loop: Loop, delay: int) -> float:
    """Return what the slowest deviation is multiplied by in a tick of the position loop, commands `delay` ticks late.

    The state: q, v, the observer's position and velocity, integrator, PI's output, current, and commands on their way.
    """
    size = 7 + delay
    period = np.zeros((size, size))
    for column in range(size):
        period[:, column] = _one_period(loop, np.eye(size)[column])
    return float(np.abs(np.linalg.eigvals(period)).max())


def _one_period(loop: Loop, state: Array) -> Array:
    q, v, seen_q, seen_v, integrator, held, current, *late = state
    step = loop.period
    for tick in range(loop.ratio):
        if tick == 0:
            integrator -= loop.ki * step * loop.ratio * q
            held = integrator - loop.kv * loop.kp * q
        current += loop.current_gain * (held - loop.kv * seen_v - current)
        late.append(current)
        torque = late.pop(0)
        q, v = q + step * (v + 0.5 * step * torque), v + step * torque
        predicted = seen_q + step * seen_v
        innovation = q - predicted
        seen_q = predicted + (1.0 - loop.pole**2) * innovation
        seen_v += (1.0 - loop.pole) ** 2 / step * innovation
    return np.array([q, v, seen_q, seen_v, integrator, held, current, *late])


def motion(setup: Setup, seconds: int = SECONDS) -> TrajectoryPoints:
    """Return a motion there and back with up to 0.75 rad/s, a second each way."""
    rows = [HOME + (k % 2) * TURN for k in range(seconds + 1)]
    rest = [[0.0] * 6] * len(rows)
    names = setup.robot.joint_names
    return TrajectoryPoints.create(
        names, names, [float(k) for k in range(len(rows))], rows, rest, [[]] * len(rows)
    )


def run(setup: Setup, ages: NDArray[np.int64]) -> tuple[Array, int]:
    """Run the motion with commands that are `ages` ticks old, shape (ticks,).

    Returns:
        The largest position error rad and motor torque Nm of each joint, shape (2, 6), and the tick in which the
        supervision cut the power; -1.
    """
    plant, controller = setup.plant(), setup.cs7b()
    plant.reset(HOME)
    controller.reset(plant.motor_states()[0])
    controller.trajectory.accept(motion(setup), 0, 0)
    (position, velocity, torque), joints = plant.motor_states(), plant.joint_states()[0]
    sent, worst, end = [], np.zeros((2, 6)), -1
    for tick, age in enumerate(ages.tolist()):
        sent.append(controller.step(position, velocity).copy())
        if tick % setup.rates.ratio == 0:
            worst[0] = np.maximum(worst[0], np.abs(controller.setpoint[0] - joints))
        if controller.fault is not None and end < 0:
            end = tick
        plant.step(sent[max(tick - age, 0)])
        worst[1] = np.maximum(worst[1], np.abs(torque))
    return worst, end


def constant(ticks: int, delay: int) -> NDArray[np.int64]:
    """Return ages of commands that are all late alike."""
    return np.full(ticks, delay)


def in_turns(ticks: int, size: int) -> NDArray[np.int64]:
    """Return ages where the nodes take turns: `size` ticks get the command that answers the tick before them."""
    return np.asarray(np.arange(ticks) % size + 1 if size else np.zeros(ticks, np.int64))


def main() -> int:
    """Compute and print the table."""
    setup = Setup.load()
    loop, ticks = Loop.of(setup), SECONDS * setup.rates.base_hz
    rows = []
    for delay in DELAYS:
        cells = [
            str(delay),
            f"{delay * setup.rates.period * 1e3:g}",
            f"{spectral_radius(loop, delay):.3f}",
        ]
        for ages in (constant(ticks, delay), in_turns(ticks, delay)):
            worst, end = run(setup, ages)
            share = float((worst[1] / setup.drives.peak_torque).max())
            fault = "" if end < 0 else f", fault at {end * setup.rates.period:.2f} s"
            cells.append(f"{worst[0].max() * 1e3:.2f} mrad, {share:.0%}{fault}")
        rows.append(tuple(cells))
    print_table(
        (
            "ticks",
            "ms",
            "linear loop",
            "all commands late by as much",
            "as many ticks on one command",
        ),
        rows,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
