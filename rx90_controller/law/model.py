"""The controller's model of the arm and its friction, for the feed-forward: files and compiled torque.

Inverse dynamics, and bristles that follow the set-points, run at the position rate, as the paper's FF block does, and
their torque is held for a period. They are evaluated at the set-point of the time at which the torque acts in the mean,
`lead` later: half a period, because it is held, and the delay of the current loop. The set-points are extrapolated to
that time with their own accelerations, because a trajectory that arrives later may change the generator's future
set-points, of which the nodes would know fewer than the loop without ROS.

The friction model is the plant's with the velocity of the set-points as input, the bristles' state included. With
LuGre's law that is the observer of Canudas de Wit, Olsson, Astrom and Lischinsky (1995), without the correction by the
error and driven by the desired velocity instead of the measured one. It uses no measurement, so it cannot make the loop
oscillate, however wrong its parameters are. Each bristle takes its exact step over the period, and the feed-forward
is the mean torque over it; at rest both stay constant, to the last bit.

Elements may have the parts of rx90_common/friction/parts, stepped by the same functions as the plant's and driven by
the set-points alone, so that even load is no algebraic loop (docs/explanation/compensation.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field

from rx90_common.arm_dynamics import (
    body_dtype,
    inverse_dynamics,
    manipulator_dtype,
    manipulator_record,
)
from rx90_common.base.arrays import Array, Record, record_type
from rx90_common.base.errors import ConfigError
from rx90_common.base.models import FileModel
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.share import resolve_config
from rx90_common.description.coupling import ArmSize, to_motor_torque
from rx90_common.description.drives import DriveParameters, load_drives
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import DESCRIPTIONS, FILES, NO_TOOL
from rx90_common.friction import FrictionElement, load_friction
from rx90_common.friction.arm_elements import (
    add_to_joints,
    element_inputs,
    fill_arm_parts,
    of_motors,
    transmit,
)
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import element_arrays, elements_dtype, load_elements
from rx90_common.friction.parts.step import (
    advance_parts,
    parts_dtype,
    parts_energy,
    parts_state_dtype,
    parts_step,
    settle_parts,
)
from rx90_common.friction.parts.temperature import (
    add_work,
    advance_temperatures,
    follow_temperatures,
    start_temperatures,
)
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, fma, load, size, store

INVERSE_DYNAMICS, FRICTION = 1, 2
"""Bits of `parts`: the parts that are on."""
FRESH = -1
"""`parts` of a state that has been through no position tick."""


@cache
def model_dtype(arm: ArmSize) -> np.dtype[np.void]:
    """Return the type of the constants; all zero where no part is on."""
    friction = record_type(elements=elements_dtype(arm.elements), parts=parts_dtype(arm.elements))
    return record_type(
        parts=np.int64,
        arm=manipulator_dtype(arm.joints),
        friction=friction,
        lead=(),  # s
        period=(),  # of the position loop, s
    )


@cache
def model_state_dtype(arm: ArmSize) -> np.dtype[np.void]:
    """Return the type of the state."""
    n, e, _ = arm
    friction = record_type(
        parts=parts_state_dtype(e),
        # whether the temperatures have been computed, or are those of the start
        warm=np.int64,
        z=e,  # deflections of the bristles, rad
        # Workspace.
        joint=n,
        motor=n,
    )
    return record_type(
        parts=np.int64,  # of the last position tick
        friction=friction,
        body=body_dtype(n),  # workspace
        before=n,  # motor side, Nm: the feed-forward before the parts changed
        # Workspace.
        q=n,
        v=n,
        a=n,
        joint=n,
        motor=n,
    )


ROLES = ("urdf", "tool", "drives", "friction")
"""The files of a model, by their names in the block `model` and in ModelFiles."""


@dataclass(frozen=True)
class ArmModel:
    """What the files of a model hold, of use to the compiled law.

    Attributes:
        arm: without friction, shape (1,), of `manipulator_dtype(n)`.
        friction: the elements; their scatter counts with its mean, which is nothing.
        drives: gears, and how much heat the motors give.
    """

    arm: Record
    friction: tuple[FrictionElement, ...]
    drives: DriveParameters

    def fill(self, model: Any, period: float) -> None:
        """Write arm and friction into a record of `model_dtype`, zero before, for position ticks of `period`, s."""
        model["arm"] = self.arm[0]
        model["friction"]["elements"] = element_arrays(self.friction)[0]
        drives = self.drives
        fill_arm_parts(
            model["friction"]["parts"],
            self.friction,
            drives.turning,
            drives.gear,
            drives.motor_heat,
            period,
        )


def _as_text(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value


FileName: TypeAlias = Annotated[str | None, BeforeValidator(_as_text)]


class ModelFiles(FileModel):
    """What the controller knows of the arm, for inverse_dynamics and friction_model; it may be wrong.

    A relative path is looked for in this file's folder, then in config/. A file that is left out is the robot folder's
    own, beside this file. Of friction that scatters the mean is taken.
    """

    urdf: Annotated[FileName, Field(description=f"The {DESCRIPTIONS['urdf']}.")] = None
    tool: Annotated[FileName, Field(description=f"The {DESCRIPTIONS['tool']}.")] = None
    drives: Annotated[FileName, Field(description=f"The {DESCRIPTIONS['drives']}.")] = None
    friction: Annotated[FileName, Field(description=f"The {DESCRIPTIONS['friction']}.")] = None

    def resolved(self, controller: Path) -> ModelFiles:
        """Return them as absolute paths, "none" for no tool; only those that are named must exist.

        Args:
            controller: the controller file that names them.
        """
        found: dict[str, Path | str] = {role: controller.parent / FILES[role] for role in ROLES}
        if not (controller.parent / FILES["tool"]).is_file():
            found["tool"] = NO_TOOL
        for role in ROLES:
            name = getattr(self, role)
            if role == "tool" and name == NO_TOOL:
                found[role] = NO_TOOL
            elif name is not None:
                try:  # the same file from whatever folder a program is started
                    found[role] = resolve_config(name, controller.parent)
                except ConfigError:
                    accepted = "a path from this file's folder or from config/, or an absolute one"
                    raise ConfigError(
                        f"{plain(controller)}: model.{role} is {quoted(name)}; accepted: a {DESCRIPTIONS[role]}: "
                        f"{accepted}"
                    ) from None
        return ModelFiles.model_validate(found)

    def path(self, role: str) -> Path | None:
        """Return the path of a file, None for no tool."""
        name = getattr(self, role)
        return None if name in (None, NO_TOOL) else Path(name)

    @cached_property
    def constants(self) -> ArmModel:
        """Return the contents, read once."""
        paths = {role: path for role in ROLES if (path := self.path(role)) is not None}
        for role, path in paths.items():
            if not path.is_file():
                raise ConfigError(
                    f"the feed-forward by a model needs {plain(path)}, which is not there; accepted: {FILES[role]} "
                    f"beside the controller file, or model.{role} in it"
                )
        robot = load_robot(paths["urdf"], paths.get("tool"))
        drives = load_drives(paths["drives"])
        robot.check_count(paths["drives"], "gear", drives.gear)
        friction = load_friction(
            paths["friction"], drives.turning.element_names(robot.joint_names)
        ).elements
        known = tuple(element.replaced(scatter=None) for element in friction)
        return ArmModel(manipulator_record(robot.chain, drives), known, drives)


@kernel
def add_model_torque(law: Any, state: Any, setpoint: Array) -> None:
    """Add the torque of the parts that are on to `feed_forward`, motor side, and advance the model's bristles.

    Args:
        law: constants, a record of `controller_dtype`.
        state: a record of `law_state_dtype`.
        setpoint: joint position rad, velocity rad/s, acceleration rad/s^2, shape (3, n).
    """
    model = law.model
    own = state.model
    lead = model.lead
    n = size(own.q)
    elements = size(own.friction.z)
    a = load(setpoint[2], n)
    v = fma(lead, a, load(setpoint[1], n))
    q = fma(lead, fma(0.5 * lead, a, load(setpoint[1], n)), load(setpoint[0], n))
    store(own.q, q)
    store(own.v, v)
    store(own.a, a)
    rigid = model.parts & INVERSE_DYNAMICS != 0
    friction = model.parts & FRICTION != 0
    parted = friction and model.friction.parts.used != 0
    if rigid or parted:
        inverse_dynamics(model.arm, own.body, own.q, own.v, own.a, own.joint)
    if parted:
        _parted_friction(law, own, not _frictional(own.parts))
    if not rigid:
        store(own.joint, 0.0 * a)
    if parted:
        add_to_joints(law.gear, own.joint, load(own.friction.parts.friction, elements))
    elif friction:
        law_of = load_elements(model.friction.elements, elements)
        inputs = element_inputs(law.gear, own.v)
        z, torque = bristle_step(law_of, load(own.friction.z, elements), inputs, model.period)
        store(own.friction.z, z)
        add_to_joints(law.gear, own.joint, torque)
    to_motor_torque(law.gear, own.joint, own.motor)
    store(state.feed_forward, load(state.feed_forward, n) + load(own.motor, n))


@inlined
def _frictional(parts: int) -> bool:
    """Return whether the friction model was on in a position tick with these parts."""
    return parts != FRESH and parts & FRICTION != 0


@kernel
def begin_parts(state: Any) -> None:
    """Store the feed-forward before other parts are switched on; bristles that were off begin undeflected."""
    own = state.model
    own.before[:] = state.feed_forward
    if not _frictional(own.parts):
        own.friction.z[:] = 0.0


@kernel
def hand_over(law: Any, state: Any) -> None:
    """Add to the integrators, within their limits, the feed-forward that was removed; subtract the one that was added.

    Parts may be switched while the arm is held. The inverse dynamics then carry the weight, which the integrators have
    carried until now: without this correction the arm would jump. After a reset the integrators are 0.
    """
    own = state.model
    if own.parts != FRESH:
        for i in range(size(own.before)):
            limit = law.integrator_limit[i]
            unlimited = state.integrator[i] + (own.before[i] - state.feed_forward[i])
            limited = min(max(unlimited, -limit), limit)
            state.position_torque[i] += limited - state.integrator[i]
            state.integrator[i] = limited
    own.parts = law.model.parts


@kernel
def _parted_friction(law: Any, own: Any, begins: bool) -> None:
    """Write the torques of elements with parts, Nm, to `own.friction.parts.friction`, and advance their bristles.

    `own.joint` is the arm's torque without friction, Nm. If the motion `begins`, the bristles are undeflected, and the
    load is at once the transmitted one.
    """
    friction = law.model.friction
    state = own.friction
    period = law.model.period
    n = size(state.z)
    transmit(law.gear, law.model.arm.rotor, own.joint, own.a, state.parts.transmitted)
    transmitted = load(state.parts.transmitted, n)
    if begins:
        settle_parts(friction.parts, state.parts, transmitted, 0.0, n)
        if state.warm:
            follow_temperatures(friction.parts.temperature, state.parts.temperature, n)
        else:
            start_temperatures(friction.parts.temperature, state.parts.temperature, n)
            state.warm = 1
    angle = element_inputs(law.gear, own.q)
    velocity = element_inputs(law.gear, own.v)
    z, torque = parts_step(
        friction.elements, friction.parts, state.parts, load(state.z, n), angle, velocity, period, n
    )
    store(state.z, z)
    store(state.parts.friction, torque)
    advance_parts(friction.parts, state.parts, transmitted, period, n)
    if friction.parts.temperature.used:
        # Friction, and motors that move the arm against it, heat the joints over the period.
        add_work(state.parts.temperature, torque, velocity, period, n)
        store(state.joint, load(own.joint, size(own.joint)))
        add_to_joints(law.gear, state.joint, load(state.parts.friction, n))
        to_motor_torque(law.gear, state.joint, state.motor)
        motor = load(state.motor, size(state.motor))
        stored = parts_energy(friction.elements, friction.parts, state.parts, load(state.z, n), n)
        _heat(law.model, state, stored, of_motors(law.gear, motor * motor))


@inlined
def _heat(model: Any, state: Any, stored: Lanes, motor: Lanes) -> None:
    n = size(state.z)
    advance_temperatures(
        model.friction.parts.temperature, state.parts.temperature, stored, motor, model.period, n
    )


@kernel
def cool_model(laws: Record, states: Record, count: int) -> None:
    """Let the joints of the model cool over `count` position ticks without motion and torque.

    Args:
        laws: constants, shape (1,), `controller_dtype`.
        states: state, shape (1,), `law_state_dtype`.
        count: ticks.
    """
    model = laws[0].model
    state = states[0].model.friction
    if state.warm and model.friction.parts.temperature.used:
        nothing = 0.0 * load(state.parts.temperature.stored, size(state.z))
        store(state.parts.temperature.stored, nothing)
        for _ in range(count):
            _heat(model, state, nothing, nothing)
