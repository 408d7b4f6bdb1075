"""What the controller knows of the arm and its friction, for the feed-forward by a model: files and compiled torque.

Inverse dynamics, and bristles that follow the set-points, run at the position rate, as the paper's FF block does, and
their torque is held for a period. They are evaluated at the set-point of the time at which it acts in the mean, `lead`
later: half a period, because it is held, and the delay of the current loop. The set-points are driven on to there with
their own accelerations: a trajectory that comes later may change what the generator has ahead, and the nodes would know
less of it than the loop without ROS.

The friction model is the plant's with the velocity of the set-points as input, the bristles' state included. With
LuGre's that is the observer of Canudas de Wit, Olsson, Astrom and Lischinsky (1995), without the correction by the
error and driven by what is wanted instead of what is measured. Nothing measured enters, so it cannot make the loop
oscillate, however wrong its parameters are. Each bristle takes its exact step over the period, and what is fed forward
is the mean torque over it; at rest both stay as they are, to the last bit.

Elements may have the parts of rx90_common/friction/parts, stepped by the same functions as the plant's and driven by
the set-points alone, so that even load is no algebraic loop (docs/explanation/compensation.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.base.entries import LEFT_OUT, Text
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group
from rx90_common.base.quoting import plain
from rx90_common.base.section import Section
from rx90_common.base.share import config_path
from rx90_common.description.drives import DriveParameters, load_drives, to_motor_torque
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import DESCRIPTIONS, FILES, NO_TOOL
from rx90_common.dynamics import BODY_DTYPE, MANIPULATOR_DTYPE, manipulator_record
from rx90_common.dynamics.manipulator import inverse_dynamics
from rx90_common.friction import ELEMENT_COUNT, FrictionElement, load_friction
from rx90_common.friction.arm_elements import add_to_joints, element_inputs, fill_arm_parts, of_motors, transmit
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import element_arrays, elements_dtype, load_elements
from rx90_common.friction.parts.load import advance_load
from rx90_common.friction.parts.step import parts_dtype, parts_energy, parts_state_dtype, parts_step, settle_parts
from rx90_common.friction.parts.temperature import (
    add_work,
    advance_temperatures,
    follow_temperatures,
    start_temperatures,
)
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, fma, load, store

INVERSE_DYNAMICS, FRICTION = 1, 2
"""Bits of `parts`: what is on."""
FRICTION_DTYPE = np.dtype(
    [("elements", elements_dtype(ELEMENT_COUNT)), ("parts", parts_dtype(ELEMENT_COUNT))], align=True
)
"""Constants."""

FRICTION_STATE_DTYPE = np.dtype(
    [
        ("z", np.float64, ELEMENT_COUNT),  # deflections of the bristles, rad
        ("parts", parts_state_dtype(ELEMENT_COUNT)),
        ("warm", np.int64),  # whether the temperatures are those of what has been, not those of the start
        # Workspace.
        ("joint", np.float64, 6),
        ("motor", np.float64, 6),
    ],
    align=True,
)

FRESH: Final = -1
"""`parts` of a state that has been through no position tick."""

MODEL_DTYPE = np.dtype(
    [
        ("parts", np.int64),
        ("arm", MANIPULATOR_DTYPE),
        ("friction", FRICTION_DTYPE),
        ("lead", np.float64),  # s
        ("period", np.float64),  # of the position loop, s
    ],
    align=True,
)
"""Constants; all zero where no part is on."""

MODEL_STATE_DTYPE = np.dtype(
    [
        ("parts", np.int64),  # of the last position tick
        ("friction", FRICTION_STATE_DTYPE),
        ("before", np.float64, 6),  # motor side, Nm: what was fed forward before the parts changed
        # Workspace.
        ("body", BODY_DTYPE),
        ("q", np.float64, 6),
        ("v", np.float64, 6),
        ("a", np.float64, 6),
        ("joint", np.float64, 6),
        ("motor", np.float64, 6),
    ],
    align=True,
)


ROLES: Final = ("urdf", "tool", "drives", "friction")
"""The files of a model, by their names in the block `model` and in ModelFiles."""

MODEL = Group(
    "What the controller knows of the arm, for inverse_dynamics and friction_model; it may be wrong. A relative path "
    "is looked for in this file's folder, then in config/. A file that is left out is the robot folder's own, beside "
    "this file. Of friction that scatters the mean is taken.",
    keys={role: Text(f"The {DESCRIPTIONS[role]}.", default=LEFT_OUT) for role in ROLES},
    default=LEFT_OUT,
)
"""The block `model` of a controller file."""


@dataclass(frozen=True)
class ArmModel:
    """What the files of a model hold, of use to the compiled law.

    Attributes:
        arm: without friction, shape (1,), MANIPULATOR_DTYPE.
        friction: the seven elements; their scatter counts with its mean, which is nothing.
        drives: gears, and how much heat the motors give.
    """

    arm: np.ndarray[Any, Any]
    friction: tuple[FrictionElement, ...]
    drives: DriveParameters

    def fill(self, model: Any, period: float) -> None:
        """Write arm and friction into a record of MODEL_DTYPE, zero before, for position ticks of `period`, s."""
        model["arm"], model["friction"]["elements"] = self.arm[0], element_arrays(self.friction)[0]
        fill_arm_parts(model["friction"]["parts"], self.friction, self.drives.gear, self.drives.motor_heat, period)


@dataclass(frozen=True)
class ModelFiles:
    """The files of the controller's own model of arm and friction.

    Attributes:
        urdf: of the arm.
        tool: on its flange; None for none.
        drives: rotors and springs count.
        friction: the seven elements.
    """

    urdf: Path
    tool: Path | None
    drives: Path
    friction: Path

    @classmethod
    def of(cls, root: Section) -> ModelFiles:
        """Return the files that a controller file names, or that lie beside it; only named ones must be there.

        Raises:
            ConfigError: for a named one that is not.
        """
        named = root.section("model") if "model" in root else Section({}, root.file, "model")
        found: dict[str, Path | None] = {}
        for role in ROLES:
            if role in named:
                name = Text("").take(named, role)
                found[role] = None if (role, name) == ("tool", NO_TOOL) else _resolved(named, role, name)
            else:
                beside = root.file.parent / FILES[role]
                found[role] = None if role == "tool" and not beside.is_file() else beside
        return cls(**found)  # type: ignore[arg-type]  # None only for the tool

    @cached_property
    def constants(self) -> ArmModel:
        """Return what they hold, read once.

        Raises:
            ConfigError: naming file, key, value and what is accepted.
        """
        for role in ROLES:
            path: Path | None = getattr(self, role)
            if path is not None and not path.is_file():
                raise ConfigError(
                    f"the feed-forward by a model needs {plain(path)}, which is not there; accepted: {FILES[role]} "
                    f"beside the controller file, or model.{role} in it"
                )
        robot, drives = load_robot(self.urdf, self.tool), load_drives(self.drives)
        friction = load_friction(self.friction, robot.joint_names).elements
        known = tuple(replace(element, scatter=None) for element in friction)
        return ArmModel(manipulator_record(robot.chain, drives), known, drives)


def _resolved(named: Section, role: str, name: str) -> Path:
    """Return a file that a controller file names: the same one from whatever folder a program is started."""
    try:
        own = Path(name).expanduser()
        found = own if own.is_absolute() else named.file.parent / own
        if not found.is_file() and not own.is_absolute():
            found = config_path(name)
        if found.is_file():
            return found
    except (OSError, RuntimeError, ConfigError):  # a name that the system does not take, a home that does not exist
        pass
    accepted = "a path from this file's folder or from config/, or an absolute one"
    named.refuse(role, name, f"a {DESCRIPTIONS[role]}: {accepted}")
    raise AssertionError


@kernel
def add_model_torque(law: Any, state: Any, setpoint: Array) -> None:
    """Add the torque of the parts that are on to `feed_forward`, motor side, and advance the model's bristles.

    Args:
        law: constants, a record of CONTROLLER_DTYPE.
        state: a record of LAW_STATE_DTYPE.
        setpoint: joint position rad, velocity rad/s, acceleration rad/s^2, shape (3, 6).
    """
    model, own = law.model, state.model
    lead = model.lead
    a = load(setpoint[2], 6)
    v = fma(lead, a, load(setpoint[1], 6))
    q = fma(lead, fma(0.5 * lead, a, load(setpoint[1], 6)), load(setpoint[0], 6))
    store(own.q, q)
    store(own.v, v)
    store(own.a, a)
    rigid, friction = model.parts & INVERSE_DYNAMICS != 0, model.parts & FRICTION != 0
    parted = friction and model.friction.parts.used != 0
    if rigid or parted:
        inverse_dynamics(model.arm, own.body, own.q, own.v, own.a, own.joint)
    if parted:
        _parted_friction(law, own, not _frictional(own.parts))
    if not rigid:
        store(own.joint, 0.0 * a)
    if parted:
        add_to_joints(own.joint, load(own.friction.parts.friction, 7))
    elif friction:
        z, torque = bristle_step(
            load_elements(model.friction.elements, 7), load(own.friction.z, 7), element_inputs(own.v), model.period
        )
        store(own.friction.z, z)
        add_to_joints(own.joint, torque)
    to_motor_torque(law.gear, own.joint, own.motor)
    store(state.feed_forward, load(state.feed_forward, 6) + load(own.motor, 6))


@inlined
def _frictional(parts: int) -> bool:
    """Return whether the friction model was on in a position tick with these parts."""
    return parts != FRESH and parts & FRICTION != 0


@kernel
def begin_parts(state: Any) -> None:
    """Keep what was fed forward before other parts are on; bristles that were off begin undeflected."""
    own = state.model
    for i in range(6):
        own.before[i] = state.feed_forward[i]
    if not _frictional(own.parts):
        for i in range(ELEMENT_COUNT):
            own.friction.z[i] = 0.0


@kernel
def hand_over(law: Any, state: Any) -> None:
    """Let the integrators give, within their limits, what is no longer fed forward, and less where more is.

    Parts may be switched while the arm is held. The inverse dynamics then bring the weight, which the integrators have
    held until now: without this the arm would jump. After a reset the integrators hold nothing.
    """
    own = state.model
    if own.parts != FRESH:
        for i in range(6):
            limit = law.integrator_limit[i]
            wanted = state.integrator[i] + (own.before[i] - state.feed_forward[i])
            given = min(max(wanted, -limit), limit)
            state.position_torque[i] += given - state.integrator[i]
            state.integrator[i] = given
    own.parts = law.model.parts


@kernel
def _parted_friction(law: Any, own: Any, begins: bool) -> None:
    """Write the torques of elements with parts, Nm, to `own.friction.parts.friction`, and advance their bristles.

    `own.joint` is what the arm takes without friction, Nm. Where it `begins`, the bristles are undeflected, and the
    load is at once what is transmitted.
    """
    friction, state, period = law.model.friction, own.friction, law.model.period
    transmit(law.model.arm.rotor, own.joint, own.a, state.parts.transmitted)
    transmitted = load(state.parts.transmitted, 7)
    if begins:
        settle_parts(friction.parts, state.parts, transmitted)
        if state.warm:
            follow_temperatures(friction.parts.temperature, state.parts.temperature, 7)
        else:
            start_temperatures(friction.parts.temperature, state.parts.temperature, 7)
            state.warm = 1
    velocity = element_inputs(own.v)
    z, torque = parts_step(
        friction.elements, friction.parts, state.parts, load(state.z, 7), element_inputs(own.q), velocity, period, 7
    )
    store(state.z, z)
    store(state.parts.friction, torque)
    advance_load(friction.parts.load, state.parts, transmitted, period, 7)
    if friction.parts.temperature.used:
        # Friction, and motors that move the arm against it, heat the joints over the period.
        add_work(state.parts.temperature, torque, velocity, period, 7)
        store(state.joint, load(own.joint, 6))
        add_to_joints(state.joint, load(state.parts.friction, 7))
        to_motor_torque(law.gear, state.joint, state.motor)
        motor = load(state.motor, 6)
        stored = parts_energy(friction.elements, friction.parts, state.parts, load(state.z, 7), 7)
        _heat(law.model, state, stored, of_motors(motor * motor))


@inlined
def _heat(model: Any, state: Any, stored: Lanes, motor: Lanes) -> None:
    advance_temperatures(model.friction.parts.temperature, state.parts.temperature, stored, motor, model.period, 7)


@kernel
def cool_model(laws: Record, states: Record, count: int) -> None:
    """Let the joints of the model cool over `count` position ticks without motion and torque.

    Args:
        laws: constants, shape (1,), CONTROLLER_DTYPE.
        states: state, shape (1,), LAW_STATE_DTYPE.
        count: ticks.
    """
    model, state = laws[0].model, states[0].model.friction
    if state.warm and model.friction.parts.temperature.used:
        nothing = 0.0 * load(state.parts.temperature.stored, 7)
        store(state.parts.temperature.stored, nothing)
        for _ in range(count):
            _heat(model, state, nothing, nothing)


class ModelTemperatures:
    """Views of a controller's state; all stays at 0 where its model has no temperatures, or its friction is off.

    Args:
        law: constants, shape (1,), CONTROLLER_DTYPE.
        state: of the law, shape (1,), LAW_STATE_DTYPE.

    Attributes:
        now: of the seven friction elements, degrees Celsius, shape (7,).
        heat: of friction and motors since they were set, or since the start, J, shape (7,).
    """

    def __init__(self, law: np.ndarray[Any, Any], state: np.ndarray[Any, Any]) -> None:
        self._law, self._state = law, state
        warmth = state["model"]["friction"]["parts"]["temperature"]
        self.now: Array = warmth["temperature"][0]
        self.heat: Array = warmth["heat"][0]

    def set(self, temperatures: Array) -> None:
        """Let them go on from these, degrees Celsius, shape (7,), instead of the start that the file gives."""
        _set(self._law, self._state, np.ascontiguousarray(temperatures))


@kernel
def _set(laws: Record, states: Record, temperatures: Array) -> None:
    part, state = laws[0].model.friction.parts.temperature, states[0].model.friction
    start_temperatures(part, state.parts.temperature, 7)
    store(state.parts.temperature.temperature, load(temperatures, 7))
    follow_temperatures(part, state.parts.temperature, 7)
    state.warm = 1
