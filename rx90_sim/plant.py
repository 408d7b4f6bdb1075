"""The plant as the nodes and the closed loop use it: motor torques in, sampled states out; or seen from the joints."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rx90_common.arm_dynamics import body_dtype, manipulator_dtype, manipulator_record
from rx90_common.base.arrays import Array, Record, RecordType, record_type
from rx90_common.base.errors import ConfigError, DivergenceError
from rx90_common.base.rates import Rates, ticks_per
from rx90_common.description.coupling import (
    ArmSize,
    gear_type,
    to_joint,
    to_joint_torque,
    to_motor_torque,
)
from rx90_common.description.drives import LINK, DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_common.friction import FrictionSet
from rx90_common.friction.arm_elements import fill_arm_parts
from rx90_common.friction.compiled_elements import element_arrays, elements_dtype
from rx90_common.friction.parts.scatter import check_seed
from rx90_common.friction.parts.step import parts_dtype, parts_state_dtype
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.elementary import exponential_of
from rx90_sim.drives import (
    cogging_dtype,
    cogging_state_dtype,
    fill_cogging,
    fill_sensor,
    fill_windings,
    sensor_dtype,
    sensor_state_dtype,
    winding_dtype,
)
from rx90_sim.elastic_gears import transmission_dtype, transmission_state_dtype
from rx90_sim.plant_step import friction_states, plant_reset, plant_step
from rx90_sim.plant_steps import MAX_STEPS, plant_steps

_MAX_CORRECTIONS = 50


@cache
def plant_dtype(arm: ArmSize) -> RecordType:
    """Return the type of the constants of a plant."""
    n, e, _ = arm
    return record_type(
        arm=manipulator_dtype(n),
        friction=elements_dtype(e),
        brake=elements_dtype(e),  # a closed brake is a stiff bristle element on its motor
        parts=parts_dtype(e),
        gear=gear_type(arm),
        peak_torque=n,
        resolution=n,  # of the encoder, motor side, rad
        observer_position=(),  # gains of the velocity observer
        observer_velocity=(),
        lower=n,
        upper=n,
        stop_stiffness=n,
        stop_damping=n,
        period=(),
        substeps=np.int64,
        speed_limit=n,
        transmission=transmission_dtype(n),
        cogging=cogging_dtype(n),
        winding=winding_dtype(n),
        sensor=sensor_dtype(n),
    )


@cache
def state_dtype(arm: ArmSize) -> RecordType:
    """Return the type of the state of a plant."""
    n, e, _ = arm
    return record_type(
        ("saturated", np.int64, (n,)),  # ticks in which a motor gave less than its command
        brakes_closed=np.int64,
        transmission=transmission_state_dtype(n),
        cogging=cogging_state_dtype(n),
        sensor=sensor_state_dtype(n),
        body=body_dtype(n),
        parts=parts_state_dtype(e),  # of friction elements with parts alone
        q=n,
        v=n,
        z=e,
        brake_z=e,
        acceleration=n,  # mean over the last step
        drive_torque=n,  # joint side, Nm
        motor_torque=n,
        motor_position=n,  # measured by the encoder
        motor_velocity=n,  # estimated by the observer
        observer=n,  # the observer's position
        temperature=n,  # of the windings, degrees Celsius
        # Workspace of a step; the factor of the mass matrix is also the next step's predictor.
        mass_matrix=(n, n),
        factor=(n, n),
        bias=n,
        q_mid=n,
        v_mid=n,
        rhs=n,
        after_friction=n,  # drive torque less friction, of elements with parts alone, Nm
    )


def _plant_record(
    robot: RobotModel,
    drives: DriveParameters,
    friction: FrictionSet,
    rates: Rates,
    substeps: int | None,
    seed: int,
) -> Record:
    """Return the constants of a `Plant`, shape (1,), of `plant_dtype`."""
    _check(drives, rates, substeps, seed)
    arm = manipulator_record(robot.chain, drives)
    substeps = plant_steps(robot, drives, friction, arm, rates.period, substeps)
    step = rates.period / substeps
    for name, element in zip(friction.names, friction.elements, strict=True):
        if element.load is not None and element.load.relax_time < step:
            raise ConfigError(
                f"friction.{name}.load.relax_time is {element.load.relax_time:g} s; accepted: at least the plant's "
                f"step, {step:g} s"
            )
    turning = drives.turning
    record = np.zeros(1, plant_dtype(turning.size))
    plant = record[0]
    plant["arm"] = arm[0]
    _fill_transmission(plant["transmission"], drives)
    fill_cogging(plant["cogging"], drives.cogging, drives.gear)
    fill_windings(plant["winding"], drives.winding, drives.torque_constant)
    if plant["transmission"]["flexible"]:
        plant["arm"]["rotor"] = 0.0  # the rotors move on their own
    plant["friction"] = element_arrays(friction.elements)[0]
    fill_arm_parts(
        plant["parts"],
        friction.elements,
        turning,
        drives.gear,
        drives.motor_heat,
        rates.period,
        seed,
    )
    fill_sensor(plant["sensor"], drives.current_sensor, drives.torque_constant, rates.period, seed)
    _fill_brakes(plant["brake"], drives)
    turning.fill(plant, "gear", drives.gear)
    plant["peak_torque"] = drives.peak_torque
    plant["resolution"] = 2.0 * math.pi / drives.encoder_counts
    pole = exponential_of(-2.0 * math.pi * drives.velocity_bandwidth * rates.period)
    plant["observer_position"] = 1.0 - pole * pole
    plant["observer_velocity"] = (1.0 - pole) * (1.0 - pole) / rates.period
    plant["lower"] = robot.lower
    plant["upper"] = robot.upper
    plant["stop_stiffness"] = drives.end_stops.stiffness
    plant["stop_damping"] = drives.end_stops.damping
    plant["period"] = rates.period
    plant["substeps"] = substeps
    plant["speed_limit"] = 10.0 * robot.max_velocity
    return record


def _check(drives: DriveParameters, rates: Rates, substeps: int | None, seed: int) -> None:
    """Refuse friction that is too fast for the tick."""
    if substeps is not None and not (
        isinstance(substeps, int | np.integer) and 1 <= substeps <= MAX_STEPS
    ):
        raise ConfigError(f"substeps is {substeps}; accepted: an integer >= 1, up to {MAX_STEPS}")
    if drives.velocity_bandwidth >= rates.base_hz / 2:
        raise ConfigError(
            f"velocity_bandwidth is {drives.velocity_bandwidth} Hz; accepted: below half the base rate, "
            f"{rates.base_hz / 2:g} Hz"
        )
    check_seed(seed)


def _fill_transmission(transmission: Any, drives: DriveParameters) -> None:
    elasticity = drives.elasticity
    elastic = elasticity.elastic
    transmission["flexible"] = elastic.any()
    transmission["elastic"] = elastic
    transmission["link_friction"] = elasticity.friction == LINK
    transmission["rotor"] = drives.rotor_inertia
    transmission["stiffness"] = np.where(elastic, elasticity.stiffness, 0.0)
    transmission["damping"] = elasticity.damping
    transmission["half_play"] = 0.5 * np.array(elasticity.backlash)


def _fill_brakes(brake: Any, drives: DriveParameters) -> None:
    """Write the brakes, bristle elements with the inputs of the friction elements.

    The brake of a motor that turns with several joints is behind those of the joints, and its own joint has none: in
    the RX family motor 6 turns with joints 5 and 6 together, so its brake is the seventh.
    """
    braked = list(drives.turning.element_of_motor)
    brake["tau_c"] = brake["tau_s"] = brake["alpha"] = 1.0
    brake["tau_c"][:, braked] = brake["tau_s"][:, braked] = drives.brake.torque
    brake["inverse_omega_s"][braked] = brake["delta"][braked] = 1.0
    brake["c0"][braked] = drives.brake.stiffness
    brake["c1"][braked] = drives.brake.damping


class Plant:
    """The arm with its drives and friction, advanced tick by tick.

    Args:
        robot: the arm.
        drives: gears, motors, brakes, spring, end stops.
        friction: the elements.
        rates: of the loops.
        substeps: plant steps in a tick; None for as many as the arm needs (rx90_sim.plant_steps).
        seed: of all that is random in the plant.

    Attributes:
        joint_names: names of the joints.
        friction: the friction elements.
        tick: number of the tick whose states are sampled now.
        constants: compiled constants, shape (1,), of `plant_dtype`.
        state: compiled state, shape (1,), of `state_dtype`.
        temperatures: of the friction elements, degrees Celsius, shape (e,), a view of the state; 0 for those without.
    """

    def __init__(
        self,
        robot: RobotModel,
        drives: DriveParameters,
        friction: FrictionSet,
        rates: Rates,
        substeps: int | None = None,
        seed: int = 0,
    ) -> None:
        self._robot = robot
        self.joint_names = robot.joint_names
        self.friction = friction
        self.constants = _plant_record(robot, drives, friction, rates, substeps, seed)
        self.state: Record = (state := np.zeros(1, state_dtype(drives.turning.size)))
        self.tick = 0
        sensed = self.constants["sensor"]["used"][0]
        torque = state["sensor"]["torque"][0] if sensed else state["motor_torque"][0]
        self._motor_states = state["motor_position"][0], state["motor_velocity"][0], torque
        self._joint_states = state["q"][0], state["v"][0], state["drive_torque"][0]
        self._friction_states = (
            state["z"][0],
            np.zeros(len(friction.names)),
            np.zeros(len(friction.names)),
        )
        self._no_command = np.zeros(len(self.joint_names))
        self.temperatures: Array = state["parts"]["temperature"]["temperature"][0]
        self.reset(np.clip(self._no_command, robot.lower, robot.upper))

    def reset(self, position: ArrayLike) -> None:
        """Put the arm at rest at `position`, rad, shape (n,), brakes closed, tick 0.

        It is the position by the encoders; where gears are elastic, the links hang a little off it.
        """
        target = np.array(position, dtype=np.float64)
        self._robot.check_position("initial position", target)
        plant_reset(self.constants, self.state, target)
        self.tick = 0

    def position_of(self, links: ArrayLike) -> Array:
        """Return the position for `reset`, rad, shape (n,), that leaves the links at rest in the required position.

        Exact to the last bit wherever rounding allows, so that a run repeated from its first sample has the same
        bits.
        """
        target = np.array(links, dtype=np.float64)
        position = target.copy()
        for _ in range(_MAX_CORRECTIONS):
            self.reset(position)
            off = target - self.state["q"][0]
            if not off.any():
                break
            position += off
        return position

    def warm_up(self) -> None:
        """Compile, or load, every kernel that a run calls, and come back to the state before."""
        before = self.state.copy()
        tick = self.tick
        self.reset(before["q"][0])
        self.step(self._no_command)
        self.step(None)
        self.friction_states()
        self.state[:] = before
        self.tick = tick

    def step(self, command: Array | None) -> None:
        """Hold motor torques for one tick; None switches the torque off and closes the brakes.

        Args:
            command: motor torques, motor side, Nm, shape (n,).

        Raises:
            DivergenceError: naming joint and tick; the state is invalid afterwards.
        """
        torques = self._no_command if command is None else command
        joint = plant_step(self.constants, self.state, torques, command is not None)
        self.tick += 1
        if joint >= 0:
            self.raise_divergence(joint)

    def raise_divergence(self, joint: int) -> NoReturn:
        """Raise the error that names joint and tick."""
        raise DivergenceError(
            f"the state of {self.joint_names[joint]} diverged in tick {self.tick}: velocity "
            f"{self.state['v'][0, joint]:g} rad/s; accepted: finite and up to "
            f"{self.constants['speed_limit'][0, joint]:g} rad/s"
        )

    @property
    def substeps(self) -> int:
        """Return how many steps the plant takes in a tick."""
        return int(self.constants["substeps"][0])

    @property
    def brakes_closed(self) -> bool:
        """Return whether the brakes hold the arm."""
        return bool(self.state["brakes_closed"][0])

    @property
    def saturated(self) -> NDArray[np.int64]:
        """Return for how many ticks each motor gave less than its command, shape (n,)."""
        return np.array(self.state["saturated"][0])

    def winding_temperatures(self) -> Array:
        """Return how warm the windings of the motors are, degrees Celsius, shape (n,)."""
        return np.array(self.state["temperature"][0])

    def motor_states(self) -> tuple[Array, Array, Array]:
        """Return position by the encoder rad, observed velocity rad/s, torque by the current sensor Nm, motor side.

        Views of the state, always the same ones.
        """
        return self._motor_states

    def joint_states(self) -> tuple[Array, Array, Array]:
        """Return joint position rad, velocity rad/s and drive torque at the joint Nm, shape (n,); views, as above."""
        return self._joint_states

    def friction_states(self) -> tuple[Array, Array, Array]:
        """Return bristle deflection rad, input velocity rad/s and friction torque Nm, shape (e,).

        Always the same arrays, brought up to date by this call.
        """
        _, velocity, torque = self._friction_states
        friction_states(self.constants, self.state, velocity, torque)
        return self._friction_states


def beyond_law(friction: FrictionSet, temperatures: Array) -> str:
    """Return in words which elements are warmer, degrees Celsius, than their law holds; '' if none is."""
    return ", ".join(
        f"{name} at {now:.1f} °C keeps the friction of {part.highest:g} °C, the highest of its law"
        for name, element, now in zip(friction.names, friction.elements, temperatures, strict=True)
        if (part := element.temperature) is not None and now > part.highest
    )


class JointInterface:
    """Joint positions, velocities and efforts of an arm whose motors alone are measured and driven.

    A motor may turn with several joints, as motor 6 of the RX family does with joints 5 and 6. Positions and torques
    are transformed so that power is the same on both sides: motor torque times motor velocity is effort times joint
    velocity, summed over the arm.

    Args:
        plant: the arm.
        rates: of the simulation.
        command_hz: how often efforts are commanded, Hz.

    Attributes:
        ticks: base ticks that a command is held for.
    """

    def __init__(self, plant: Plant, rates: Rates, command_hz: int) -> None:
        self.ticks = ticks_per("command_rate", rates.base_hz, command_hz)
        self._plant = plant.constants
        joints = len(plant.joint_names)
        self._motor_states = plant.motor_states()
        self._measured = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self._torques = np.zeros(joints)
        self.measure()

    def measure(self) -> tuple[Array, Array, Array]:
        """Return position by encoders rad, observed velocity rad/s, torque by current sensors Nm, all at the joints.

        Shape (n,); always the same arrays, brought up to date by this call.
        """
        _to_joints(self._plant, *self._motor_states, *self._measured)
        return self._measured

    def motor_torques(self, effort: Array) -> Array:
        """Return the motor torques, motor side, that make efforts at the joints, Nm, shape (n,).

        Always the same array, which the next call overwrites.
        """
        _to_motors(self._plant, effort, self._torques)
        return self._torques


@kernel
def _to_joints(
    plants: Record,
    of_motor: Array,
    speed: Array,
    torque: Array,
    position: Array,
    velocity: Array,
    effort: Array,
) -> None:
    to_joint(plants[0].gear, of_motor, position)
    to_joint(plants[0].gear, speed, velocity)
    to_joint_torque(plants[0].gear, torque, effort)


@kernel
def _to_motors(plants: Record, effort: Array, torque: Array) -> None:
    to_motor_torque(plants[0].gear, effort, torque)
