"""Instructions and functions of locations."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.vplus import transformations
from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.operators import location, real, truth
from rx90_emulator.vplus.registry import Waits, function, functions, instruction
from rx90_emulator.vplus.syntax import Argument, Line
from rx90_emulator.vplus.task import Task
from rx90_emulator.vplus.values import Joints, Value, kind_of

_JOINTS = 6
_SAME = 1e-3  # mm, and 1e-3 of a turn's matrix


def tool_at(task: Task, q: Array) -> Array:
    """Return where the tool is in the world at joint angles, rad, shape (6,)."""
    settings = task.settings
    return base_of(task) @ task.cell.arm.flange(q) @ settings.tool


def base_of(task: Task) -> Array:
    """Return where the robot stands in the world."""
    base = task.settings.base
    return base if task.readings.base_moves_robot else transformations.inverse(base)


def flange_for(task: Task, place: Array) -> Array:
    """Return the flange in the robot's own world, for a place of the tool in the world."""
    return transformations.inverse(base_of(task)) @ place @ transformations.inverse(task.settings.tool)


def as_transformation(task: Task, value: Value) -> Array:
    """Return a location as a transformation, a precision point by its forward kinematics."""
    if isinstance(value, Joints):
        return tool_at(task, task.cell.arm.angles(value))
    return location(value)


@instruction("SET", 1)
def set_location(task: Task, line: Line) -> None:
    """Store a location; a precision point becomes a transformation where the variable is for one."""
    target = task.variable(line.arguments[0])
    if line.value is None:
        raise VplusError("Missing argument", "SET without a value")
    value = task.value(line.value)
    if not isinstance(value, Joints | np.ndarray):
        raise VplusError("Illegal assignment", f"SET {target.name} = a {kind_of(value)}; accepted: a location")
    if isinstance(value, Joints) and target.name[0] != "#":
        value = as_transformation(task, value)
    task.cell_of(target).store(target.name, value)


@instruction("HERE", 1)
def store_here(task: Task, line: Line) -> None:
    """Store where the arm is."""
    target = task.variable(line.arguments[0])
    q = task.cell.drive.position()
    value: Value = task.cell.arm.joints(q) if target.name[0] == "#" else tool_at(task, q)
    task.cell_of(target).store(target.name, value)


@instruction("DECOMPOSE", 1)
def decompose(task: Task, line: Line) -> None:
    """Store the six numbers of a location in an array, from an index on."""
    target = task.variable(line.arguments[0])
    if line.value is None:
        raise VplusError("Missing argument", "DECOMPOSE without a location")
    value = task.value(line.value)
    numbers = value if isinstance(value, Joints) else transformations.six_numbers(location(value))
    index = [0 if part is None else int(real(task.value(part))) for part in target.index or (None,)]
    for place, number in enumerate(numbers):
        cell = task.table(target.name).cell(target.name, (*index[:-1], index[-1] + place))
        cell.store(target.name, float(number))


@instruction("TOOL", 0, 1)
def set_tool(task: Task, line: Line) -> Waits:
    """Set the tool, once the motion has ended."""
    tool = location(task.value(line.arguments[0])) if line.arguments else np.eye(4)  # type: ignore[arg-type]
    yield from task.until(lambda: task.cell.queue.at_end, "the end of the motion")
    task.settings.tool = tool


@instruction("BASE", 0, 4)
def set_base(task: Task, line: Line) -> Waits:
    """Say where the robot stands, once the motion has ended: x, y, z, and its turn about z."""
    place = six_reals(task, line.arguments)  # x, y, z and the turn about z
    yield from task.until(lambda: task.cell.queue.at_end, "the end of the motion")
    task.settings.base = transformations.trans(*place)


def six_reals(task: Task, arguments: tuple[Argument, ...]) -> list[float]:
    """Return up to six numbers, 0 for those that are left out."""
    return [task.real(argument, 0.0) for argument in arguments]


@function("TRANS", 0, _JOINTS, trees=True)
def trans(task: Task, *arguments: Argument) -> Array:
    """Return a transformation of x, y, z, yaw, pitch, roll."""
    return transformations.trans(*six_reals(task, arguments))


@function("#PPOINT", 0, _JOINTS, trees=True)
def precision_point(task: Task, *arguments: Argument) -> Joints:
    """Return a precision point of joint values."""
    numbers = six_reals(task, arguments)
    return Joints([*numbers, *[0.0] * (_JOINTS - len(numbers))])


@function("SHIFT", 1, 4, trees=True)
def shift(task: Task, place: Argument, *by: Argument) -> Array:
    """Return a location that is shifted along the axes in which its numbers stand."""
    moved = location(task.item(place)).copy()  # type: ignore[arg-type]
    for axis, distance in enumerate(by):
        moved[axis, 3] += task.real(distance, 0.0)
    return moved


@function("FRAME", 4)
def frame(_: Task, origin: Value, on_x: Value, beside: Value, place: Value) -> Array:
    """Return the frame of four locations."""
    found = transformations.frame(location(origin), location(on_x), location(beside), location(place))
    if found is None:
        raise VplusError("Illegal value", "FRAME of locations on one line")
    return found


@function("INRANGE", 1)
def in_range(task: Task, place: Value) -> float:
    """Return 0 for a location that the arm reaches; else bit n for joint n, or bit 14 where no joints would do."""
    queue = task.cell.queue
    arm = task.cell.arm
    if isinstance(place, Joints):
        outside = arm.outside(arm.angles(place))
        return float(sum(2 ** (joint - 1) for joint in outside))
    try:
        posture = task.settings.posture(arm.posture(queue.destination))
        arm.solve_target(flange_for(task, location(place)), posture, queue.destination)
    except VplusError as error:
        name = error.text.rpartition("Jt ")[2]
        return float(2 ** (int(name) - 1)) if name.isdigit() else float(2**13)
    return 0.0


@function("CONFIG")
def configuration(task: Task) -> float:
    """Return the present configuration as bits: 1 for LEFTY, 2 for BELOW, 4 for FLIP."""
    posture = task.cell.arm.posture(task.cell.drive.position())
    lefty = posture.shoulder == "back"
    below = (posture.elbow == "positive") == lefty
    flip = posture.wrist == "negative"
    return float((1 if lefty else 0) + (2 if below else 0) + (4 if flip else 0))


def _scaled(place: Value, factor: Value) -> Array:
    return transformations.placed(location(place)[:3, :3], location(place)[:3, 3] * real(factor))


def _distance(left: Value, right: Value) -> float:
    return float(np.linalg.norm(location(left)[:3, 3] - location(right)[:3, 3]))


def _is_same(left: Value, right: Value) -> bool:
    return bool(np.abs(np.array(left) - np.array(right)).max() < _SAME)


functions(
    {
        "HERE": (0, lambda task: tool_at(task, task.cell.drive.position())),
        "DEST": (0, lambda task: tool_at(task, task.cell.queue.destination)),
        "#PHERE": (0, lambda task: task.cell.arm.joints(task.cell.drive.position())),
        "#PDEST": (0, lambda task: task.cell.arm.joints(task.cell.queue.destination)),
        "NULL": (0, lambda _: np.eye(4)),
        "TOOL": (0, lambda task: task.settings.tool),
        "BASE": (0, lambda task: task.settings.base),
        "INVERSE": (1, lambda _, place: transformations.inverse(location(place))),
        "DX": (1, lambda _, place: float(location(place)[0, 3])),
        "DY": (1, lambda _, place: float(location(place)[1, 3])),
        "DZ": (1, lambda _, place: float(location(place)[2, 3])),
        "RX": (1, lambda _, angle: transformations.placed(transformations.turn_x(real(angle)), np.zeros(3))),
        "RY": (1, lambda _, angle: transformations.trans(pitch=real(angle))),
        "RZ": (1, lambda _, angle: transformations.trans(yaw=real(angle))),
        "SCALE": (2, lambda _, place, factor: _scaled(place, factor)),
        "DISTANCE": (2, lambda _, left, right: _distance(left, right)),
        "IDENTICAL": (2, lambda _, left, right: truth(_is_same(left, right))),
    }
)
