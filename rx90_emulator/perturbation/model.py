"""The perturbation model as programs use it: prepared once for a motion, run for many parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from rx90_common.arm_dynamics import mass_and_bias
from rx90_common.base.arrays import Array, Record
from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates
from rx90_common.description.coupling import to_motor
from rx90_common.description.drives import DriveParameters
from rx90_common.description.kinematics import forward, jacobian
from rx90_common.description.robot import RobotModel
from rx90_common.friction import FrictionSet
from rx90_common.friction.friction_file import refuse_parts
from rx90_common.kernels.compiled import kernel
from rx90_controller.law.parameters import MODEL_PARTS, CS7BParameters
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.loop.setup import Setup
from rx90_emulator.perturbation.group_step import FEW, Series, Tables, lanes_for, pack, run_few, run_many
from rx90_sim.plant_steps import plant_steps

SPACING = 0.01
"""From one point of the linearisation to the next, s."""


class NominalMotion(NamedTuple):
    """A prescribed motion over n base ticks, in steps of constant acceleration between their ends.

    Attributes:
        position: q0 on ticks, rad, shape (n + 1, 6).
        velocity: v0 on ticks, rad/s, shape (n + 1, 6).
        middle_position: q0 in the middle of the steps, rad, shape (n, 6).
        middle_velocity: v0 there, rad/s, shape (n, 6).
        acceleration: mean over the steps, rad/s^2, shape (n, 6).
        slip: by how much a step of constant acceleration falls short of the next position, rad, shape (n, 6).
    """

    position: Array
    velocity: Array
    middle_position: Array
    middle_velocity: Array
    acceleration: Array
    slip: Array


def nominal_motion(trajectory: TrajectoryGenerator, ticks: int, rates: Rates) -> NominalMotion:
    """Return the motion of the set-points on base ticks.

    Args:
        trajectory: the generator that has accepted the motion, on ticks of the position loop.
        ticks: length of the motion in base ticks.
        rates: rates of the loops.
    """
    generator = trajectory.refined(rates.ratio)
    position, velocity, _ = np.moveaxis(generator.setpoints(0, ticks + 1), 1, 0)
    step = rates.period
    acceleration = np.diff(velocity, axis=0) / step
    return NominalMotion(
        position=np.ascontiguousarray(position),
        velocity=np.ascontiguousarray(velocity),
        middle_position=position[:-1] + 0.5 * step * (velocity[:-1] + 0.25 * step * acceleration),
        middle_velocity=0.5 * (velocity[:-1] + velocity[1:]),
        acceleration=acceleration,
        slip=np.diff(position, axis=0) - 0.5 * step * (velocity[:-1] + velocity[1:]),
    )


@kernel
def nominal_torque(plants: Record, states: Record, motion: NominalMotion) -> Array:
    """Return tau0 = M a0 + h without friction in the middle of the steps, Nm, shape (n, 6).

    Args:
        plants: constants of the plant, shape (1,), of `plant_dtype`.
        states: state of a plant, shape (1,), of `state_dtype`; its workspace is overwritten.
        motion: the nominal motion.
    """
    plant, state = plants[0], states[0]
    torque = np.empty((len(motion.acceleration), 6))
    for k in range(len(torque)):
        q, v, acceleration = motion.middle_position[k], motion.middle_velocity[k], motion.acceleration[k]
        mass_and_bias(plant.arm, state.body, q, v, state.mass_matrix, state.bias)
        for i in range(6):
            torque[k, i] = state.bias[i]
            for j in range(6):
                torque[k, i] += state.mass_matrix[i, j] * acceleration[j]
    return torque


class Linearisation(NamedTuple):
    """Derivatives of the inverse dynamics M a + h along a motion.

    Attributes:
        mass: M0 = M(q0), rotors included, kg m^2, shape (n, joints, joints).
        damping: C0 = dh/dv, Nm s/rad, shape (n, joints, joints).
        stiffness: K0 = d(M a0 + h)/dq, gravity and spring included, Nm/rad, shape (n, joints, joints).
    """

    mass: Array
    damping: Array
    stiffness: Array


def linearise(
    robot: RobotModel, drives: DriveParameters, position: Array, velocity: Array, acceleration: Array
) -> Linearisation:
    """Return M0, C0 and K0 at n points of a motion.

    Args:
        robot: the arm with its tool.
        drives: rotors and spring.
        position: rad, shape (n, joints).
        velocity: rad/s, shape (n, joints).
        acceleration: rad/s^2, shape (n, joints).
    """
    data = robot.model.createData()
    count, joints = position.shape
    mass, damping, stiffness = (np.empty((count, joints, joints)) for _ in range(3))
    for n, state in enumerate(zip(position, velocity, acceleration, strict=True)):
        by_position, by_velocity, by_acceleration = pin.computeRNEADerivatives(robot.model, data, *state)
        upper = np.triu(by_acceleration)
        mass[n] = upper + np.triu(upper, 1).T
        damping[n], stiffness[n] = by_velocity, by_position
    # The rotors' inertia is the same in every pose, so it adds to M0 alone; the spring gives k cos(q) to K0.
    mass += drives.rotor_matrix
    diagonal = np.arange(joints)
    stiffness[:, diagonal, diagonal] += drives.spring_torque * np.cos(position)
    return Linearisation(mass, damping, stiffness)


@dataclass(frozen=True)
class PerturbationResult:
    """Runs about one nominal motion, on position ticks 0, 1, ..., m - 1.

    Attributes:
        model: what ran.
        joint_deviation: dq, rad, shape (runs, m, 6).
        bristles: deflections of the seven friction elements, rad, shape (runs, m, 7).
        tip_deviation: J(q0) dq, m, shape (runs, m, 3).
        saturated: ticks in which each amplifier was at its limit, shape (runs, 6).
        tripped: whether a joint went beyond a limit of the controller's supervision, which would have cut the power;
            the series go on without it. Shape (runs,).
        diverged: whether a joint exceeded its speed limit tenfold; such a run's series mean nothing. Shape (runs,).
    """

    model: PerturbationModel
    joint_deviation: Array
    bristles: Array
    tip_deviation: Array
    saturated: NDArray[np.int64]
    tripped: NDArray[np.bool_]
    diverged: NDArray[np.bool_]

    def joint_position(self, run: int) -> Array:
        """Return q0 + dq of a run, rad, shape (m, 6)."""
        return np.asarray(self.model.slow_position + self.joint_deviation[run])

    def tip_position(self, run: int) -> Array:
        """Return the tip's position along the nominal motion plus J(q0) dq of a run, m, shape (m, 3)."""
        return np.asarray(self.model.nominal_tip + self.tip_deviation[run])


@dataclass(frozen=True, eq=False)
class PerturbationModel:
    """Everything about a nominal motion that does not depend on friction and controllers.

    Attributes:
        setup: robot, drives and rates; friction and controller of runs that bring none.
        motion: the nominal motion.
        tables: what compiled code reads.
        spacing: base ticks from one point of the linearisation to the next.
        initial_position: rad, shape (6,).
        nominal_tip: tip's position along the nominal motion on position ticks, m, shape (m, 3).
        plants: constants of the plant, shape (1,), of `plant_dtype`; the drives' count.
    """

    setup: Setup
    motion: NominalMotion
    tables: Tables
    spacing: int
    initial_position: Array
    nominal_tip: Array
    plants: Record

    @property
    def times(self) -> Array:
        """Return the times of the series, s, shape (m,)."""
        return np.asarray(np.arange(len(self.nominal_tip), dtype=np.float64) * self.setup.rates.position_period)

    @property
    def slow_position(self) -> Array:
        """Return q0 on position ticks, rad, shape (m, 6)."""
        return self.motion.position[: -1 : self.setup.rates.ratio]

    def run_one(
        self, friction: FrictionSet | None = None, controller: CS7BParameters | None = None
    ) -> PerturbationResult:
        """Run once, with the setup's own friction and controller unless others are given."""
        return self.run([friction or self.setup.friction], None if controller is None else [controller])

    def run(
        self, frictions: Sequence[FrictionSet], controllers: Sequence[CS7BParameters] | None = None
    ) -> PerturbationResult:
        """Run a batch; what a run gives does not depend on its neighbours.

        Args:
            frictions: one for each run.
            controllers: one for each run, or None for the setup's own in all of them.

        Raises:
            ConfigError: if the batch is empty, the numbers of frictions and controllers differ, an element has a part,
                a controller feeds forward by a model, or friction needs more than one plant step in a tick.
        """
        runs = len(frictions)
        if runs == 0:
            raise ConfigError("a batch of 0 runs; accepted: at least one")
        if controllers is not None and len(controllers) != runs:
            raise ConfigError(f"{len(controllers)} controllers for {runs} friction sets; accepted: one for each")
        setup, tables = self.setup, self.tables
        for friction in frictions:
            elements = dict(zip(friction.names, friction.elements, strict=True))
            refuse_parts(elements, "the perturbation method", held=("bristles",))
            # Its step is the plant's of a tick, so it bears no more.
            arm = self.plants["arm"]
            plant_steps(setup.robot, setup.drives, friction, arm, setup.rates.period, requested=1, braked=False)
        laws = []
        for controller in controllers or [setup.controller]:
            for name in MODEL_PARTS:
                if getattr(controller.feed_forward, name):
                    raise ConfigError(f"feed_forward.{name} is true; accepted: false, by the perturbation method")
            laws.append(controller.record(setup.robot, setup.drives, setup.rates))
        lanes = lanes_for(runs)
        groups = pack(frictions, laws if controllers else laws * runs, lanes)
        states, motion = groups.states, self.motion
        states["q"] = (self.initial_position - motion.position[0])[:, None]
        states["v"] = -motion.velocity[0][:, None]
        states["excess"] = -tables.torque[0][:, None]  # the brakes held the arm until now
        rows = len(self.nominal_tip)
        series = Series(*(np.empty((runs, rows, columns)) for columns in (6, 7, 3)))
        run = run_few if lanes == FEW else run_many
        run(self.plants, tables, self.spacing, setup.rates.ratio, groups, series)
        # A diverged run may have counted into NaN.
        saturated = np.nan_to_num(np.moveaxis(states["saturated"], 2, 1).reshape(-1, 6)[:runs])
        tripped, diverged = (states[name].reshape(-1)[:runs].astype(np.bool_) for name in ("tripped", "diverged"))
        return PerturbationResult(self, *series, saturated.astype(np.int64), tripped, diverged)


def prepare_perturbation(
    setup: Setup,
    points: TrajectoryPoints,
    initial_position: ArrayLike,
    duration: float,
    start_time: float = 0.0,
    spacing: float = SPACING,
) -> PerturbationModel:
    """Prepare the model of a motion; the arguments mean what they mean to `simulate`.

    Args:
        setup: robot, drives, friction, controller, rates.
        points: the trajectory.
        initial_position: joint positions at rest, rad, shape (6,).
        duration: simulated time, s.
        start_time: when the trajectory starts, s.
        spacing: from one point of the linearisation to the next, s.

    Raises:
        ConfigError: if duration or spacing is shorter than a tick, a time is not finite, or the initial position is
            not six numbers within the joint limits, or a drive is more than a rigid gear and a torque.
        TrajectoryError: if the trajectory is refused.
    """
    rates = setup.rates
    start, ticks = rates.start_tick(start_time), rates.ticks_of(duration)
    if not rates.period <= spacing < np.inf:
        raise ConfigError(f"spacing is {spacing} s; accepted: a finite number, at least a tick, {rates.period:g} s")
    if not setup.drives.turning.size.wrist:
        raise ConfigError(
            "the perturbation method holds six joints with the RX family's wrist alone; accepted: rx90_run"
        )
    for i in np.flatnonzero(setup.drives.elasticity.elastic):
        found = f"drives.elasticity.stiffness[{i}] is {setup.drives.elasticity.stiffness[i]:g} Nm/rad"
        raise ConfigError(f"{found}; accepted by the perturbation method: rigid drives")
    for name in ("cogging", "winding", "current_sensor"):
        if getattr(setup.drives, name).used:
            raise ConfigError(f"drives.{name}: the perturbation method cannot hold this; accepted: left out")
    plant, controller = setup.plant(), setup.cs7b()
    plant.reset(initial_position)
    encoders = plant.motor_states()[0]
    controller.reset(encoders)
    controller.trajectory.accept(points, 0, start)
    setpoints = controller.trajectory.setpoints(0, -(-ticks // rates.ratio))
    motion = nominal_motion(controller.trajectory, ticks, rates)
    slow = motion.position[: -1 : rates.ratio]
    apart = max(1, round(spacing * rates.base_hz))
    # The coefficients at every so many ticks, one point past the end, for which the last one stands in.
    last = len(motion.acceleration) - 1
    at = np.minimum(np.arange(0, last + 2 * apart, apart), last)
    linear = linearise(setup.robot, setup.drives, motion.position[at], motion.velocity[at], motion.acceleration[at])
    reference = np.empty_like(setpoints)
    for row, motor in zip(setpoints.reshape(-1, 6), reference.reshape(-1, 6), strict=True):
        to_motor(setup.drives.gear, row, motor)
    tables = Tables(
        position=motion.position,
        velocity=motion.middle_velocity,
        torque=nominal_torque(plant.constants, plant.state, motion),
        slip=motion.slip,
        coefficients=np.stack([np.linalg.inv(linear.mass), linear.damping, linear.stiffness], axis=1),
        reference=reference,
        jacobian=np.ascontiguousarray(jacobian(setup.robot.chain, slow)[:, :3]),
    )
    tip = forward(setup.robot.chain, slow).position
    return PerturbationModel(
        setup, motion, tables, apart, np.array(initial_position, dtype=np.float64), tip, plant.constants
    )
