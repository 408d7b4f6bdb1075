"""Instructions of motion, and what they keep: speeds, accelerations, switches."""

from __future__ import annotations

from typing import Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.vplus import transformations
from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.locations import as_transformation, base_of, flange_for, tool_at
from rx90_emulator.vplus.motion import Motion, Profile, check_line, straight
from rx90_emulator.vplus.operators import location
from rx90_emulator.vplus.registry import Waits, functions, instruction, instructions
from rx90_emulator.vplus.settings import Speed
from rx90_emulator.vplus.syntax import Line
from rx90_emulator.vplus.task import Task
from rx90_emulator.vplus.transformations import inverse, trans
from rx90_emulator.vplus.values import Joints

_INCH: Final = 25.4
_LARGEST_SPEED: Final = 1000.0
_LONGEST: Final = 3600.0
_SHORTEST_WAY: Final = 1e-9
_NULL_TIME: Final = 2.0  # s, until errors must be small


def _profile(task: Task, motion: Motion, speed: Speed, duration: float) -> Profile:
    """Return the fastest profile of a motion within the full speeds."""
    settings = task.settings
    full = task.cell.arm.speeds
    ways: list[tuple[float, float, float]] = []  # speed and acceleration as shares of the way, and percent
    if motion.line is not None:
        if motion.line.length > _SHORTEST_WAY:
            length = motion.line.length
            ways.append((full.linear_speed / length, full.linear_acceleration / length, speed.percent))
        if motion.line.angle > _SHORTEST_WAY:
            angle = np.degrees(motion.line.angle)
            ways.append((full.rotary_speed / angle, full.rotary_acceleration / angle, speed.rotary))
    else:
        change = np.degrees(np.abs(motion.end - motion.start))
        for joint in np.flatnonzero(change > _SHORTEST_WAY):
            way = change[joint]
            ways.append((full.joint_speed[joint] / way, full.joint_acceleration[joint] / way, speed.percent))
    if not ways:
        return Profile(0.0)
    fastest = min(rate * percent / 100.0 for rate, _, percent in ways)
    steepest = min(rate * (percent / 100.0 if settings.scaled else 1.0) for _, rate, percent in ways)
    up, down = settings.acceleration
    return Profile.fastest(fastest, steepest * up / 100.0, steepest * down / 100.0, settings.smooth, duration)


def issue(task: Task, kind: str, end: Array, place: Array | None, speed: Speed | None = None) -> Waits:
    """Plan a motion to joint angles, rad, or along a line to a place in the robot's world, and wait until it begins."""
    settings = task.settings
    cell = task.cell
    taken, switches = settings.take()
    start = cell.queue.destination
    program = task.frame_of().program.name if task.frames else "DO"
    motion = Motion(kind, f"{program}:{task.line}", start, end, Profile(0.0), tool=settings.tool)
    motion.continuous = switches["CP"] != 0.0
    motion.nulls = switches["NULL"] != 0.0
    motion.at_start = settings.at_start
    if place is not None:
        motion.line = straight(cell.arm, start, place, settings.tool)
    else:
        cell.arm.check_range(end)
    motion.profile = _profile(task, motion, speed or taken, switches["DURATION"])
    if motion.line is not None:
        check_line(cell.arm, motion)
    settings.at_start = []
    if settings.dry:
        return
    cell.tolerance = switches["FINE"] / 100.0
    cell.queue.give(motion)
    cell.queue.begin_waiting(cell.settled, cell.time)
    yield from task.until(lambda: cell.queue.waiting is not motion, "the motion before")


def _go(task: Task, kind: str, target: Array | Joints, *, line: bool) -> Waits:
    """Move to a location in the world, or to joint values."""
    arm = task.cell.arm
    present = task.cell.queue.destination
    if isinstance(target, Joints):
        end = arm.angles(target)
        arm.check_range(end)
        place = arm.flange(end) @ task.settings.tool if line else None
        yield from issue(task, kind, end, place)
        return
    posture = arm.posture(present)
    end = arm.solve_target(flange_for(task, target), posture if line else task.settings.posture(posture), present)
    yield from issue(task, kind, end, inverse(base_of(task)) @ target if line else None)


def _target(task: Task, line: Line) -> Array | Joints:
    argument = line.arguments[0]
    value = task.item(argument)
    return value if isinstance(value, Joints) else location(value)  # type: ignore[arg-type]


def _move(task: Task, line: Line) -> Waits:
    """Move to a location, along a line if the word ends with S; MOVET and MOVEST open the hand or close it."""
    if len(line.arguments) > 1:
        hand = "OPEN" if task.real(line.arguments[1]) > 0.0 else "CLOSE"
        task.settings.at_start.append(lambda: task.cell.signals.set_hand(hand, task.cell.time))
    return _go(task, line.word, _target(task, line), line="S" in line.word)


def _approach(task: Task, line: Line) -> Waits:
    """Move to a place so far back along the tool's z at a location."""
    place = as_transformation(task, _target(task, line)) @ trans(z=-task.real(line.arguments[1]))
    return _go(task, line.word, place, line="S" in line.word)


def _depart(task: Task, line: Line) -> Waits:
    """Move so far back along the tool's z, from the end of the motion before."""
    place = tool_at(task, task.cell.queue.destination) @ trans(z=-task.real(line.arguments[0]))
    return _go(task, line.word, place, line="S" in line.word)


instructions(
    {
        "MOVE": (1, _move),
        "MOVES": (1, _move),
        "MOVET": (2, _move),
        "MOVEST": (2, _move),
        "APPRO": (2, _approach),
        "APPROS": (2, _approach),
        "DEPART": (1, _depart),
        "DEPARTS": (1, _depart),
    }
)


@instruction("DRIVE", 3)
def drive(task: Task, line: Line) -> Waits:
    """Move one joint by some degrees, at a percentage of its full speed."""
    joint = task.real(line.arguments[0])
    if joint not in range(1, 7):
        raise VplusError("Illegal joint number", f"{joint:g}; accepted: 1 to 6")
    percent = _percent(task.real(line.arguments[2]))
    if task.readings.drive_obeys_program_speed:
        percent = percent * (task.settings.next_speed or task.settings.speed).percent / 100.0
    end = task.cell.queue.destination.copy()
    end[int(joint) - 1] += np.radians(task.real(line.arguments[1]))
    return issue(task, "DRIVE", end, None, Speed(percent, percent))


@instruction("ALIGN")
def align(task: Task, _: Line) -> Waits:
    """Turn the tool along the nearest axis of the world, on the spot."""
    return _go(task, "ALIGN", transformations.aligned(tool_at(task, task.cell.queue.destination)), line=True)


@instruction("DELAY", 1)
def delay(task: Task, line: Line) -> Waits:
    """Let the arm stand for some seconds; it is a motion, and the program goes on meanwhile."""
    seconds = task.real(line.arguments[0])
    if not 0.0 <= seconds <= _LONGEST:
        raise VplusError("Illegal value", f"DELAY {seconds:g}; accepted: 0 to {_LONGEST:g} s")
    cell = task.cell
    present = cell.queue.destination
    profile = Profile(seconds * cell.queue.monitor / 100.0, 1e-3, 1e-3)
    motion = Motion("DELAY", f"{task.frame_of().program.name}:{task.line}", present, present, profile)
    cell.queue.give(motion)
    cell.queue.begin_waiting(cell.settled, cell.time)
    yield from task.until(lambda: cell.queue.waiting is not motion, "the motion before")


def wait_for_end(task: Task) -> Waits:
    """Wait for the end of the motion.

    Raises:
        VplusError: if the position errors stay too large.
    """
    cell = task.cell
    yield from task.until(lambda: cell.queue.at_end, "the end of the motion")
    if not cell.queue.done or not cell.queue.done[-1].nulls:
        return
    latest = cell.time + _NULL_TIME
    yield from task.until(lambda: cell.settled or cell.time > latest, "small position errors")
    if not cell.settled:
        raise VplusError("Time-out nulling errors", f"errors above {cell.arm.speeds.null_tolerance:g} deg")


def _percent(value: float) -> float:
    if not 0.0 < value <= _LARGEST_SPEED:
        raise VplusError("Illegal value", f"{value:g} %; accepted: above 0, up to {_LARGEST_SPEED:g}")
    return value


@instruction("SPEED", 1, 2)
def set_speed(task: Task, line: Line) -> None:
    """Set the speed of the next motion or, with ALWAYS, of all; or the monitor speed."""
    value = task.real(line.arguments[0])
    if "MONITOR" in line.modifiers:
        task.cell.queue.monitor = min(_percent(value), 100.0)
        return
    if "MMPS" in line.modifiers or "IPS" in line.modifiers:
        speed = value * (_INCH if "IPS" in line.modifiers else 1.0)
        percent = _percent(100.0 * speed / task.cell.arm.speeds.linear_speed)
        rotary = task.settings.speed.rotary
    else:
        percent = _percent(value)
        rotary = percent
    chosen = Speed(percent, _percent(task.real(task.argument(line, 1), rotary)))
    if "ALWAYS" in line.modifiers:
        task.settings.speed = chosen
    else:
        task.settings.next_speed = chosen


@instruction("ACCEL", 0, 2)
def set_acceleration(task: Task, line: Line) -> None:
    """Set the accelerations of ramps up and down, percent, and the profile."""
    settings = task.settings
    up = task.real(task.argument(line, 0), settings.acceleration[0])
    down = task.real(task.argument(line, 1), settings.acceleration[1])
    settings.acceleration = (float(np.clip(up, 1.0, _LARGEST_SPEED)), float(np.clip(down, 1.0, _LARGEST_SPEED)))
    if line.unit:
        settings.smooth = task.real(line.unit[0]) != 0.0


def _switch(task: Task, line: Line, name: str, value: float) -> None:
    """Set a switch for the next motion or, with ALWAYS, for all."""
    switches = task.settings.switches if "ALWAYS" in line.modifiers else task.settings.next_switches
    switches[name] = value


@instruction("DURATION", 1)
def set_duration(task: Task, line: Line) -> None:
    """Set the least time of motions, s."""
    seconds = task.real(line.arguments[0])
    if not 0.0 <= seconds <= _LONGEST:
        raise VplusError("Illegal value", f"DURATION {seconds:g}; accepted: 0 to {_LONGEST:g} s")
    _switch(task, line, "DURATION", seconds)


@instruction("FINE", 0, 1)
@instruction("COARSE", 0, 1)
def set_tolerance(task: Task, line: Line) -> None:
    """Set what small position errors are, percent; COARSE of ten times as much."""
    factor = 10.0 if line.word == "COARSE" else 1.0
    _switch(task, line, "FINE", factor * _percent(task.real(task.argument(line, 0), 100.0)))


_PARTS: Final = {
    **dict.fromkeys(("LEFTY", "RIGHTY"), "shoulder"),
    **dict.fromkeys(("ABOVE", "BELOW"), "elbow"),
    **dict.fromkeys(("FLIP", "NOFLIP"), "wrist"),
}


def _ask_for(task: Task, line: Line) -> None:
    """Ask for a configuration at the next motion that is no line."""
    task.settings.wanted[_PARTS[line.word]] = line.word


instructions(
    {
        "CPON": (0, lambda task, line: _switch(task, line, "CP", 1.0)),
        "CPOFF": (0, lambda task, line: _switch(task, line, "CP", 0.0)),
        "NULL": (0, lambda task, line: _switch(task, line, "NULL", 1.0)),
        "NONULL": (0, lambda task, line: _switch(task, line, "NULL", 0.0)),
        "BREAK": (0, lambda task, _: wait_for_end(task)),
        "BRAKE": (0, lambda task, _: task.cell.queue.stop()),
        "READY": (0, lambda task, _: issue(task, "READY", task.cell.arm.ready, None)),
        **dict.fromkeys(_PARTS, (0, _ask_for)),
    }
)


def _speed_of(task: Task, kind: float) -> float:
    """Return a speed, percent: 1 of the monitor, 2 of all motions, 3 of the next one."""
    settings = task.settings
    speeds = {1.0: task.cell.queue.monitor, 2.0: settings.speed.percent}
    return speeds.get(kind, (settings.next_speed or settings.speed).percent)


functions(
    {
        "SPEED": (1, _speed_of),
        "DURATION": (1, lambda task, _: task.settings.switches["DURATION"]),
        "ACCEL": (1, lambda task, kind: task.settings.acceleration[0 if kind == 1.0 else 1]),
    }
)
