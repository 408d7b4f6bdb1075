"""How motors turn with joints: through their gears, and some with several joints at once.

A coupling is a matrix C, shape (n, n), of motor turns for joint turns without the gears:

    motor velocity = gear * (C @ joint velocity),   joint torque = C^T @ (gear * motor torque).

Each row of it is either that of a motor that turns with its own joint alone, or that of one that turns with several.
Friction elements, and brakes, turn likewise: one for each joint, followed by one for each motor that turns with
several joints (section 4 of the paper); a joint with such a motor has no brake of its own.

The wrist coupling of the RX family is q_m5 = n5 q5 and q_m6 = n6 (q5 + q6). Compiled code computes it in a fixed order
of operations if the gears are given as an array; for any other arm they are a record with the matrices, so
that arms with as many joints and elements share the compiled code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba.core import types

from rx90_common.base.arrays import MAX_JOINTS, Array, record_type
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, listed
from rx90_common.kernels.compiled import by_type, inlined
from rx90_common.kernels.lanes import Lanes, append, first, fma, lane, load, size, store

MAX_ELEMENTS = 8
"""Friction elements that an arm may have: joints, and motors that turn with several of them."""

_SINGULAR = 1e-9  # determinant below which the motors do not determine the joints


class ArmSize(NamedTuple):
    """What compiled code is made for.

    Attributes:
        joints: of the arm, and motors.
        elements: of friction.
        wrist: whether the coupling is that of the RX family's wrist, in its fixed order of operations.
    """

    joints: int
    elements: int
    wrist: bool


_RX_JOINTS = 6


@dataclass(frozen=True, eq=False)
class Coupling:
    """Which joints each motor turns with.

    Attributes:
        turns: motor turns for joint turns without the gears, shape (n, n).
    """

    turns: Array

    def __post_init__(self) -> None:
        turns = self.turns
        if turns.ndim != 2 or turns.shape[0] != turns.shape[1] or not 1 <= len(turns) <= MAX_JOINTS:
            raise ConfigError(
                f"coupling has shape {turns.shape}; accepted: square, of 1 to {MAX_JOINTS} rows"
            )
        for i, row in enumerate(turns.tolist()):
            alone = sum(value != 0.0 for value in row) == 1
            if alone and row[i] != 1.0:
                raise ConfigError(
                    f"coupling[{i}] is {row}; accepted: 1 in column {i} for a motor that turns with one joint (gear "
                    "holds its ratio and sign), or two or more numbers other than 0"
                )
        if not abs(np.linalg.det(turns)) > _SINGULAR:
            raise ConfigError(f"coupling is {turns.tolist()}; accepted: an invertible matrix")
        if len(turns) + len(self.sums) > MAX_ELEMENTS:
            raise ConfigError(
                f"coupling has {len(self.sums)} motors that turn with several of {len(turns)} joints; accepted: up to "
                f"{MAX_ELEMENTS - len(turns)}, for {MAX_ELEMENTS} friction elements in all"
            )

    @classmethod
    @cache
    def usual(cls, joints: int) -> Coupling:
        """Return the coupling of an arm whose files have none: the RX family's wrist for six joints, else none."""
        turns = np.eye(joints)
        if joints == _RX_JOINTS:
            turns[5, 4] = 1.0
        return cls(turns)

    @cached_property
    def sums(self) -> tuple[int, ...]:
        """Return the motors that turn with several joints."""
        return tuple(np.flatnonzero(np.count_nonzero(self.turns, axis=1) > 1).tolist())

    @cached_property
    def size(self) -> ArmSize:
        """Return the properties that compiled code depends on."""
        joints = len(self.turns)
        wrist = joints == _RX_JOINTS and np.array_equal(self.turns, Coupling.usual(joints).turns)
        return ArmSize(joints, joints + len(self.sums), wrist)

    @cached_property
    def element_of_motor(self) -> tuple[int, ...]:
        """Return the friction element, and brake, that turns with each motor."""
        joints = len(self.turns)
        return tuple(joints + self.sums.index(i) if i in self.sums else i for i in range(joints))

    @cached_property
    def element_matrix(self) -> Array:
        """Return input velocities of the friction elements for joint velocities, shape (e, n)."""
        return np.vstack([np.eye(len(self.turns)), self.turns[list(self.sums)]])

    @cached_property
    def joint_turns(self) -> Array:
        """Return joint turns for motor turns, the inverse of `turns`, whole numbers to the last bit."""
        inverse = np.linalg.inv(self.turns)
        whole = np.round(inverse)
        return np.where(np.abs(inverse - whole) < 1e-12, whole, inverse)

    def of_elements(self, motors: Sequence[float], of_none: float) -> list[float]:
        """Return for each friction element the value of the motor that turns with it, `of_none` if there is none."""
        found = [of_none] * self.size.elements
        for element, value in zip(self.element_of_motor, motors, strict=True):
            found[element] = value
        return found

    def reach(self, speeds: Array) -> list[float]:
        """Return the most that the elements can have, shape (e,), where joints have these speeds, rad/s, shape (n,)."""
        return [float(value) for value in np.abs(self.element_matrix) @ speeds]

    def coupled(self, motors: Array) -> Array:
        """Return properties of motors, such as rotor inertias, seen from the joints: C^T diag(motors) C, (n, n)."""
        return self.turns.T @ np.diag(motors) @ self.turns

    def element_names(self, joint_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the friction elements: the joints' own, `joint_5_6` for an RX's wrist, else sums."""
        if len(joint_names) != len(self.turns):
            raise ConfigError(
                f"joints {listed(joint_names)}; accepted: {counted(len(self.turns), 'name')}, as the coupling has"
            )
        if self.size.wrist:
            return (*joint_names, "joint_5_6")
        return (*joint_names, *(sum_name(joint_names, self.turns[i]) for i in self.sums))

    def fill(self, record: Any, name: str, gear: Array) -> None:
        """Write gears and coupling into the field of a record that has the `gear_type` of an arm."""
        if self.size.wrist:
            record[name] = gear
            return
        turns = self.turns
        back = self.joint_turns
        sums = list(self.sums)
        belongs = np.zeros((self.size.elements, len(turns)))
        passed = back.T.copy()
        belongs[self.element_of_motor, np.arange(len(turns))] = 1.0
        belongs[sums, sums] = 1.0
        passed[sums] = np.eye(len(turns))[sums]
        gears = record[name]
        gears["ratio"] = gear
        gears["motor"] = turns
        gears["joint"] = back
        gears["motor_columns"] = turns.T
        gears["joint_columns"] = back.T
        gears["element"] = self.element_matrix
        gears["element_columns"] = self.element_matrix.T
        gears["element_of_motor"] = self.element_of_motor
        gears["belongs"] = belongs.T
        gears["passed"] = np.vstack([passed, back.T[sums]]).T


RX_WRIST = Coupling.usual(6)
"""The coupling of the RX family."""


def sum_name(names: Sequence[str], row: Array) -> str:
    """Return how an element's velocity is made of the joints', such as joint_5+joint_6: no two have the same."""
    parts: list[str] = []
    for name, share in zip(names, row.tolist(), strict=True):
        if share:
            sign = "-" if share < 0.0 else "+" if parts else ""
            parts.append(f"{sign}{'' if abs(share) == 1.0 else f'{abs(share):g}*'}{name}")
    return "".join(parts)


def gear_type(arm: ArmSize) -> Any:
    """Return what `record_type` takes for the gears of an arm: the ratios alone, or with them the coupling."""
    joints, elements, wrist = arm
    if wrist:
        return joints
    shapes: dict[str, Any] = {
        "ratio": joints,
        "motor": (joints, joints),  # turns of motors (row) for joints
        "motor_columns": (joints, joints),
        "joint": (joints, joints),  # turns of joints for motors
        "joint_columns": (joints, joints),
        "element": (elements, joints),  # turns of friction elements for joints
        "element_columns": (joints, elements),
        "belongs": (joints, elements),  # columns: which motor belongs to an element
        "passed": (joints, elements),  # columns: share of the joints' torques, through an element
    }
    return record_type(("element_of_motor", np.int64, (joints,)), **shapes)


_Function = TypeVar("_Function", bound=Callable[..., Any])


def by_gear(of_wrist: Callable[..., Any]) -> Callable[[_Function], _Function]:
    """Return a decorator of a function for kernels, whose first argument is the gears.

    The function is compiled for a record with matrices, the gears of any arm but those of the RX family.

    Args:
        of_wrist: compiled for an array, the ratios of the RX family; with the same arguments.
    """

    def decorate(of_matrices: _Function) -> _Function:
        def choose(gear: Any, *_: Any) -> Any:
            return of_matrices if isinstance(gear, types.Record) else of_wrist

        choose.__qualname__ = of_matrices.__qualname__
        return cast(_Function, by_type(choose))

    return decorate


@inlined
def times(columns: Any, x: Array) -> Lanes:
    """Return the product of a matrix, by its columns, and an array."""
    total: Lanes = x[0] * load(columns[0], size(columns))
    for k in range(1, len(columns)):
        total = fma(x[k], load(columns[k], size(columns)), total)
    return total


@inlined
def times_lanes(columns: Any, x: Lanes) -> Lanes:
    """Return the product of a matrix, by its columns, and lanes."""
    total = lane(x, 0) * load(columns[0], size(columns))
    for k in range(1, len(columns)):
        total = fma(lane(x, k), load(columns[k], size(columns)), total)
    return total


@by_gear(lambda gear: gear)
def ratios(gear: Any) -> Any:
    """Return the gear ratios of the motors, shape (n,)."""
    return gear.ratio


def _to_motor_of_wrist(gear: Array, joint: Array, motor: Array) -> None:
    for i in range(5):
        motor[i] = gear[i] * joint[i]
    motor[5] = gear[5] * (joint[4] + joint[5])


@by_gear(_to_motor_of_wrist)
def to_motor(gear: Any, joint: Array, motor: Array) -> None:
    """Write motor positions (or velocities) for joint positions (or velocities), all shape (n,).

    Here and below `gear` is declared by `gear_type`; outside of records it is an array, for the RX family's wrist.
    """
    store(motor, load(gear.ratio, size(gear.ratio)) * times(gear.motor_columns, joint))


def _to_joint_of_wrist(gear: Array, motor: Array, joint: Array) -> None:
    for i in range(5):
        joint[i] = motor[i] / gear[i]
    joint[5] = motor[5] / gear[5] - joint[4]


@by_gear(_to_joint_of_wrist)
def to_joint(gear: Any, motor: Array, joint: Array) -> None:
    """Write joint positions (or velocities) for motor positions (or velocities), all shape (n,)."""
    at_joints = load(motor, size(gear.ratio)) / load(gear.ratio, size(gear.ratio))
    store(joint, times_lanes(gear.joint_columns, at_joints))


def _to_joint_torque_of_wrist(gear: Array, motor: Array, joint: Array) -> None:
    for i in range(6):
        joint[i] = gear[i] * motor[i]
    joint[4] += joint[5]


@by_gear(_to_joint_torque_of_wrist)
def to_joint_torque(gear: Any, motor: Array, joint: Array) -> None:
    """Write the joint torques that motor torques make, all shape (n,), Nm."""
    store(
        joint,
        times_lanes(gear.motor, load(gear.ratio, size(gear.ratio)) * load(motor, size(gear.ratio))),
    )


def _to_motor_torque_of_wrist(gear: Array, joint: Array, motor: Array) -> None:
    for i in range(6):
        motor[i] = joint[i] / gear[i]
    motor[4] = (joint[4] - joint[5]) / gear[4]


@by_gear(_to_motor_torque_of_wrist)
def to_motor_torque(gear: Any, joint: Array, motor: Array) -> None:
    """Write the motor torques that make joint torques, all shape (n,), Nm."""
    store(motor, times(gear.joint, joint) / load(gear.ratio, size(gear.ratio)))


def _add_drive_torques_of_wrist(_gear: Array, drive: Array, torque: Array) -> None:
    for i in range(6):
        torque[i] += drive[i]
    torque[4] += drive[5]


@by_gear(_add_drive_torques_of_wrist)
def add_drive_torques(gear: Any, drive: Array, torque: Array) -> None:
    """Add torques of the motors, converted by their gears, Nm, to those of the joints, both shape (n,)."""
    store(torque, load(torque, size(gear.ratio)) + times(gear.motor, drive))


def _share_among_drives_of_wrist(_gear: Array, torque: Array, drive: Array) -> None:
    for i in range(6):
        drive[i] = torque[i] - (torque[5] if i == 4 else 0.0)


@by_gear(_share_among_drives_of_wrist)
def share_among_drives(gear: Any, torque: Array, drive: Array) -> None:
    """Write the motor torques, converted by their gears, that produce those of the joints, Nm, shape (n,)."""
    store(drive, times(gear.joint, torque))


def _joints_as_motors_have_them_of_wrist(gear: Array, motor: Lanes) -> Lanes:
    share = gear[5] / gear[4]
    return append(first(motor, 5), lane(motor, 5) - share * lane(motor, 4))


@by_gear(_joints_as_motors_have_them_of_wrist)
def joints_as_motors_have_them(gear: Any, motor: Lanes) -> Lanes:
    """Return the joints' positions (or velocities) times the ratios of their own motors, for those of motors; lanes."""
    ratio = load(gear.ratio, size(gear.ratio))
    return ratio * times_lanes(gear.joint_columns, motor / ratio)


def _add_twist_of_wrist(
    _gear: Array, joint: Array, twist: Array, share: float, total: Array
) -> None:
    for i in range(6):
        total[i] = joint[i] + share * twist[i]
    total[5] -= share * twist[4]


@by_gear(_add_twist_of_wrist)
def add_twist(gear: Any, joint: Array, twist: Array, share: float, total: Array) -> None:
    """Write the joints' positions (or velocities) and a share of how far twists of the drives move them, shape (n,)."""
    store(total, load(joint, size(gear.ratio)) + share * times(gear.joint_columns, twist))


def _turn_of_drive_of_wrist(_gear: Array, joint: Array, drive: int) -> float:
    turn: float = joint[drive] + joint[4] if drive == 5 else joint[drive]
    return turn


@by_gear(_turn_of_drive_of_wrist)
def turn_of_drive(gear: Any, joint: Array, drive: int) -> float:
    """Return the turn of a motor, divided by its gear ratio, for turns of the joints, shape (n,)."""
    turn = 0.0
    for k in range(size(gear.ratio)):
        turn += gear.motor[drive, k] * joint[k]
    return turn


def _add_drive_of_wrist(
    _gear: Array,
    drive: int,
    inertia: float,
    torque: float,
    mass: Array,
    joint: Array,
) -> None:
    mass[drive, drive] += inertia
    joint[drive] += torque
    if drive == 5:
        mass[4, 4] += inertia
        mass[5, 4] += inertia
        joint[4] += torque


@by_gear(_add_drive_of_wrist)
def add_drive(
    gear: Any, drive: int, inertia: float, torque: float, mass: Array, joint: Array
) -> None:
    """Add inertia and torque of a motor, through its gear, to mass matrix (lower half) and torques of the joints."""
    for i in range(size(gear.ratio)):
        turn = gear.motor[drive, i]
        joint[i] += turn * torque
        for k in range(i + 1):
            mass[i, k] += turn * gear.motor[drive, k] * inertia
