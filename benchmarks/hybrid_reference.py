"""The accurate answer: the same digital controller, the plant integrated by SciPy's stiff variable-step solver.

Between two ticks the motor torques are constant, so the plant is an initial value problem of 19 states
(6 positions, 6 velocities, 7 bristle deflections). LSODA solves it at tight tolerance; equations 17 to 19 are
written out here once more, apart from the plant step that is judged by them. The samples that the controller
sees, encoder and observer, come from the plant step's own code: they are definitions, not approximations.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import odeint
from tqdm import tqdm

from rx90_common.arm_dynamics import mass_and_bias
from rx90_common.base.arrays import Array
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.compiled_elements import element_arrays, lane_of, load_elements
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_common.kernels.compiled import kernel
from rx90_controller.lines.task import LineTask, load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.line import plan_line
from rx90_emulator.loop.result import MotionCommand, RunResult
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant
from rx90_sim.plant_step import sample_drives

TOLERANCE = 1e-12
"""Relative tolerance of LSODA on rad, rad/s and rad; the absolute one is a hundredth of it."""
_MOST_STEPS = 20_000


class Work(NamedTuple):
    """What all of them run: a setup and the points of a line."""

    setup: Setup
    task: LineTask
    points: TrajectoryPoints
    start: Array
    duration: float

    @classmethod
    def plan(cls, setup: Setup, task: LineTask) -> Work:
        """Plan a line."""
        plan = plan_line(setup, task)
        return cls(setup, task, plan.points, plan.start_pose, plan.duration)

    @classmethod
    def load(cls) -> Work:
        """Read the shipped files and plan the reference line."""
        return cls.plan(Setup.load(), load_task())

    def run(self, setup: Setup | None = None, substeps: int | None = None) -> RunResult:
        """Run the closed loop, of this setup or another one."""
        commands = (MotionCommand(0, self.points),)
        return simulate_commands(
            setup or self.setup, commands, self.start, self.duration, substeps=substeps
        )

    def setpoints(self, first: float, ticks: int) -> Array:
        """Return the set-points of `ticks` base ticks from time `first`, s, on, shape (m, 3, 6)."""
        controller, rates = self.setup.cs7b(), self.setup.rates
        controller.trajectory.reset(self.start)
        controller.trajectory.accept(self.points, 0, 0)
        return controller.trajectory.corrected(
            round(first * rates.position_hz), -(-ticks // rates.ratio)
        )


class ReferenceRun(NamedTuple):
    """States on position ticks: q, v rad and rad/s, shape (m, 6); z rad, shape (m, 7)."""

    q: Array
    v: Array
    z: Array


@kernel
def _derivative(y: Array, _: float, arm: Any, body: Any, friction: Any, drive: Array) -> Array:
    mass, bias, torque = np.empty((6, 6)), np.empty(6), np.empty(6)
    q, v, z = y[:6], y[6:12], y[12:]
    mass_and_bias(arm[0], body[0], q, v, mass, bias)
    derivative = np.empty(19)
    for i in range(6):
        torque[i] = drive[i] - bias[i]
    elements = load_elements(friction[0], 7)
    for i in range(7):
        velocity = v[i] if i < 6 else v[4] + v[5]
        e = lane_of(elements, i)
        sign = 0 if velocity >= 0 else 1
        stribeck = np.exp(-((abs(velocity) * e.inverse_omega_s) ** e.delta))
        g = (e.tau_c[sign] + (e.tau_s[sign] - e.tau_c[sign]) * stribeck) / e.c0
        z_dot = velocity - abs(velocity) / g * z[i]
        c1 = e.c1 * np.exp(-((velocity * e.inverse_omega_d) ** 2))
        tau = (
            e.c0 * z[i]
            + c1 * z_dot
            + e.c2 * velocity * max(abs(velocity), LINEAR_SPEED) ** (e.alpha - 1.0)
        )
        derivative[12 + i] = z_dot
        if i < 6:
            torque[i] -= tau
        else:
            torque[4] -= tau
            torque[5] -= tau
    # By elimination, without pivots: the matrix is positive definite. NumPy's solver takes numba seconds to compile.
    for k in range(6):
        for i in range(k + 1, 6):
            share = mass[i, k] / mass[k, k]
            torque[i] -= share * torque[k]
            for j in range(k, 6):
                mass[i, j] -= share * mass[k, j]
    for k in range(5, -1, -1):
        for j in range(k + 1, 6):
            torque[k] -= mass[k, j] * derivative[6 + j]
        derivative[k], derivative[6 + k] = v[k], torque[k] / mass[k, k]
    return derivative


class StiffPlant:
    """The arm under held motor torques, solved to a tolerance. End stops and brakes are not part of it."""

    def __init__(self, setup: Setup, plant: Plant, tolerance: float = TOLERANCE) -> None:
        """Take over the state of `plant`, whose encoders and observers go on to be read."""
        state = plant.state[0]
        self._plant, self._tolerance = plant, tolerance
        self._drives, self._period = setup.drives, setup.rates.period
        self._friction = element_arrays(setup.friction.elements)
        self.y: Array = np.concatenate([state["q"], state["v"], state["z"]])

    def step(self, command: Array) -> None:
        """Hold motor torques, Nm, shape (6,), for one tick and sample the drives."""
        plant = self._plant
        peak = self._drives.peak_torque
        motors = self._drives.gear * np.clip(command, -peak, peak)
        self._drive = self._drives.turning.turns.T @ motors
        arguments = (plant.constants["arm"], plant.state["body"], self._friction, self._drive)
        tolerances = {
            "rtol": self._tolerance,
            "atol": 0.01 * self._tolerance,
            "mxstep": _MOST_STEPS,
        }
        self.y = odeint(_derivative, self.y, (0.0, self._period), args=arguments, **tolerances)[1]
        plant.state["q"][0] = self.y[:6]
        sample_drives(plant.constants, plant.state)


def hybrid_reference(
    setup: Setup,
    points: TrajectoryPoints,
    initial_position: ArrayLike,
    duration: float,
    *,
    tolerance: float = TOLERANCE,
    bar: tqdm[Any] | None = None,
) -> ReferenceRun:
    """Run the closed loop with the plant solved by LSODA between ticks.

    Args:
        setup: robot, drives, friction, controller, rates.
        points: the trajectory, started at once.
        initial_position: joint positions at rest, rad, shape (6,).
        duration: simulated time, s.
        tolerance: relative tolerance of the solver.
        bar: progress, moved on by one for each position tick.
    """
    plant, controller = setup.plant(), setup.cs7b()
    plant.reset(initial_position)
    controller.reset(plant.motor_states()[0])
    controller.trajectory.accept(points, 0, 0)
    rates, rows = setup.rates, []
    stiff = StiffPlant(setup, plant, tolerance)
    for tick in range(round(duration * rates.base_hz)):
        if tick % rates.ratio == 0:
            rows.append(stiff.y.copy())
            if bar is not None:
                bar.update()
        position, velocity, _ = plant.motor_states()
        stiff.step(controller.step(position, velocity))
    table = np.array(rows)
    return ReferenceRun(table[:, :6], table[:, 6:12], table[:, 12:])


def negligible_element() -> FrictionElement:
    """Return friction so small that it does not show."""
    return FrictionElement(
        tau_c=1e-12, tau_s=1e-12, omega_s=1.0, delta=1.0, c0=1e-9, c1=0.0, c2=0.0
    )


def decoupled_setup(shipped: Setup, elements: Sequence[FrictionElement], inertia: float) -> Setup:
    """Return six unit-gear rotors: joints 1 to 4 carry the given elements, one each.

    The links weigh nothing, there is neither gravity nor spring, the torques are not limited. What is left of
    the plant is, joint by joint, the textbook's mass with friction.

    Args:
        shipped: where everything else comes from.
        elements: friction of the first joints, at most four; the others have none to speak of.
        inertia: of each rotor, kg m^2.
    """
    nothing, six = np.zeros((6, 3)), np.ones(6)
    chain = shipped.robot.chain._replace(
        mass=np.zeros(6), com=nothing, inertia=np.zeros((6, 6)), gravity=np.zeros(3)
    )
    robot = dataclasses.replace(
        shipped.robot, chain=chain, lower=-1e9 * six, upper=1e9 * six, max_velocity=1e4 * six
    )
    drives = shipped.drives.replaced(
        transmission={"gear": six, "rotor_inertia": inertia * six},
        motor={"torque_constant": six, "peak_current": 1e6 * six},
        spring={"torque": 0.0 * six},
    )
    padded = [*elements, *[negligible_element()] * (RX_WRIST.size.elements - len(elements))]
    friction = FrictionSet(shipped.friction.names, tuple(padded))
    return dataclasses.replace(shipped, robot=robot, drives=drives, friction=friction)
