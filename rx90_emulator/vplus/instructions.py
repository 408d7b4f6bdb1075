"""The table of instructions: the kinds of their arguments, and what they do."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from itertools import count, zip_longest
from typing import Any, Final

import numpy as np
from pinocchio import SE3

from rx90_common.base.arrays import Array
from rx90_emulator.cabinet.arm import CONFIGURATIONS, Joints
from rx90_emulator.cabinet.errors import VplusError
from rx90_emulator.cabinet.locations import aligned, six_numbers, trans
from rx90_emulator.cabinet.plan import STRAIGHT, Motion, Profile, plan
from rx90_emulator.vplus.functions import number_of, written
from rx90_emulator.vplus.task import Reaction, Task, Waits
from rx90_emulator.vplus.tree import Reference, Tree, entries
from rx90_emulator.vplus.values import Value, Variable, bounded

_UNITS = {"MMPS": 1.0, "IPS": 25.4}  # mm/s
_NULL_TIME = 2.0  # s, until errors must be small
_HAND = {"O": (3001, -3002), "C": (-3001, 3002), "R": (-3001, -3002)}
"""Signals of the hand: open, closed, relaxed."""
_BETWEEN = re.compile(r"\s*,\s*|(?<=[\d.])\s+(?=[-+.\d])")
_NO_UNITS = {None, 0.0, 1.0}
"""Units that take nothing that is typed: the robot, and its pendant."""
_REFUSED = {
    "VPICTURE VLOCATE VFEATURE VSHOW VTRAIN VDISPLAY": "vision is not emulated",
    "ALTER ALTON ALTOFF": "ALTER needs a licensed option",
    "FORCE.READ FORCE.MODE FORCE.FRAME FORCE.OFFSET": "force sensing is not emulated",
    "FOPEN FOPENA FOPEND FOPENR FOPENW FCLOSE FSET": "no files are emulated",
    "EXECUTE ABORT KILL": "one task is emulated",
    "MOVEF MOVESF": "they belong to other arms",
    "DEVICE SETDEVICE DDCMP": "no devices are emulated",
    "GETC PACK $UNPACK INTB LNGB FLTB $INTB $LNGB $FLTB": "bytes are not emulated",
}


def _nothing(*_: object) -> None:
    """Do nothing: it is of no effect here, or what follows in the program matters."""


# Control.


def _begin_for(
    task: Task, variable: Variable, first: float, limit: float, increment: float | None = None
) -> None:
    if increment == 0.0:
        raise VplusError("Illegal value", "STEP 0")
    step = increment or 1.0

    def begin_turn(value: float) -> bool:
        variable.store(value)
        return (value - limit) * step <= 0.0

    def begin_next() -> bool:
        return begin_turn(task.taken("real", variable.value) + step)  # type: ignore[arg-type]  # of this kind

    task.frame.loops[task.step.target] = begin_next
    task.jump(not begin_turn(first))


def _end(task: Task) -> None:
    """Go back to the begin of a loop, or on."""
    begin_next = task.frame.loops.get(task.frame.place)
    task.jump(begin_next is None or begin_next())


def _choose_case(task: Task, value: Value) -> None:
    """Go to the first branch that has the value, to ANY, or behind the block."""
    task.jump()
    for place in task.step.branches:
        step = task.frame.program.steps[place]
        if step.word == "ANY" or value in [
            task.taken("folded", part) for part in step.arguments if step.word == "VALUE"
        ]:
            task.frame.place = place + 1
            return


def _return(task: Task) -> None:
    task.frames.pop()


def _stop(task: Task) -> None:
    task.halted = task.step.word == "HALT"
    task.frames.clear()


def _pause(_: Task) -> None:
    raise VplusError("Program paused")


def _assign(_: Task, value: Value, target: Variable) -> None:
    if not isinstance(value, float | str):
        raise VplusError(
            "Illegal assignment", f"{target.name} = a location; accepted: SET {target.name} = ..."
        )
    target.store(value)


# Locations.


def _set(task: Task, value: SE3 | Joints, target: Variable) -> None:
    """Store a location; a precision point becomes a transformation where the variable is for one."""
    target.store(value if target.name[0] == "#" else _place(task, value))


def _place(task: Task, location: SE3 | Joints) -> SE3:
    return task.tool_at(task.arm.angles(location)) if isinstance(location, Joints) else location


def _here(task: Task, target: Variable) -> None:
    _set(task, task.arm.joints(task.cell.drive.position()), target)


def _joints_here(task: Task, *targets: Variable) -> None:
    for target, value in zip(targets, task.arm.joints(task.cell.drive.position()), strict=False):
        target.store(value)


def _decompose(task: Task, value: SE3 | Joints, target: Tree) -> None:
    """Store the six numbers of a location in an array, from an index on."""
    for place, number in enumerate(six_numbers(value)):
        task.variable(target, place).store(number)


def _set_tool(task: Task, tool: SE3 | None = None) -> Waits:
    yield from task.motion_end()
    task.tool = tool or SE3.Identity()


def _set_base(task: Task, *place: float | None) -> Waits:
    """Say where the robot stands: x, y, z, and its turn about z."""
    yield from task.motion_end()
    task.base = trans(*place)


# Motions.


def _from_rest(action: Callable[..., Waits]) -> Callable[..., Waits]:
    """Return what a motion does when a stop that is under way has ended, and the place where it begins is known."""

    def act(task: Task, *arguments: Any) -> Waits:
        yield from _may_move(task)
        yield from action(task, *arguments)

    return act


def _break(task: Task) -> Waits:
    """Wait for the end of the motion, and for small position errors."""
    yield from task.motion_end()
    cell = task.cell
    if task.queue.done and task.queue.done[-1].nulls:
        latest = cell.time + _NULL_TIME
        yield from task.until(lambda: cell.settled or cell.time > latest, "small position errors")
        if not cell.settled:
            raise VplusError(
                "Time-out nulling errors", f"errors above {task.arm.full.null_tolerance:g} deg"
            )


def _issue(task: Task, end: Array, **instead: float) -> Waits:
    """Plan a motion to joint angles, rad, and wait until it begins."""
    chosen = {**task.next, **instead}
    task.next.clear()
    motion = _motion(task, end)
    motion.continuous = chosen["CP"] != 0.0 and "CP" in task.cell.switches
    motion.nulls = chosen["NULL"] != 0.0
    motion.at_start = task.at_start
    task.at_start = []
    while True:
        plan(task.arm, motion, chosen, "SCALE.ACCEL" in task.cell.switches)
        if "DRY.RUN" in task.cell.switches:
            return
        task.cell.tolerance = chosen["FINE"] / 100.0
        yield from _give(task, motion)
        if motion.has_begun:
            return
        yield from _may_move(task)
        motion.start = task.queue.destination


def _motion(task: Task, end: Array) -> Motion:
    where = f"{task.frame.program.name}:{task.step.line}"
    return Motion(task.step.word, where, task.queue.destination, end, task.tool)


def _give(task: Task, motion: Motion) -> Waits:
    """Wait until a motion begins, or a stop of the one before drops it."""
    task.queue.give(motion, task.cell.settled, task.cell.time)
    return task.until(lambda: task.queue.waiting is not motion, "the motion before")


def _end_of_stop(task: Task) -> Waits:
    return task.until(lambda: not task.queue.stopping, "the end of a stop")


def _may_move(task: Task) -> Waits:
    """Wait for the end of a stop: only then the place where a motion begins is known, and whether there is power."""
    yield from _end_of_stop(task)
    if not task.cell.switches & {"POWER", "DRY.RUN"}:
        raise VplusError("Robot power off")


def _move(task: Task, target: SE3 | Joints, hand: float | None = None) -> Waits:
    """Move to a location, along a line or not; MOVET and MOVEST open the hand or close it at the start."""
    if hand is not None:
        _set_hand(task, "O" if hand > 0.0 else "C")
    if isinstance(target, Joints):
        return _issue(task, task.arm.angles(target))
    return _issue(task, task.solve(target, keep=task.step.word in STRAIGHT))


def _approach(task: Task, target: SE3 | Joints, distance: float) -> Waits:
    """Move to a place so far back along the tool's z at a location."""
    return _move(task, _place(task, target) * trans(0.0, 0.0, -distance))


def _depart(task: Task, distance: float) -> Waits:
    """Move so far back along the tool's z, from the end of the motion before."""
    return _approach(task, task.tool_at(task.queue.destination), distance)


def _align(task: Task) -> Waits:
    return _move(task, aligned(task.tool_at(task.queue.destination)))


def _drive(task: Task, joint: int, change: float, percent: float) -> Waits:
    """Move one joint by some degrees, at a percentage of its full speed."""
    if task.readings.drive_obeys_program_speed:
        percent *= task.next["SPEED"] / 100.0
    return _issue(
        task,
        task.queue.destination + np.radians(change) * (np.arange(1, 7) == joint),
        SPEED=percent,
    )


def _move_joints(task: Task, *values: float | None) -> Waits:
    """Move to joint values; those that are left out stay."""
    present = task.arm.joints(task.queue.destination)
    joints = (old if new is None else new for old, new in zip_longest(present, values))
    return _issue(task, task.arm.angles(Joints(joints)))


def _delay(task: Task, seconds: float) -> Waits:
    """Let the arm stand for some seconds; it is a motion, and the program goes on meanwhile."""
    motion = _motion(task, task.queue.destination)
    motion.continuous = False
    duration = seconds * task.queue.monitor / 100.0
    ramp = min(1e-3, duration / 4.0)  # any will do: there is no way
    motion.profile = Profile(duration, ramp, ramp)
    yield from _give(task, motion)
    if not motion.has_begun:
        yield from _may_move(task)
        yield from _delay(task, seconds)


def _choose(task: Task, **values: float) -> None:
    """Let values hold for the next motion or, with ALWAYS, for all."""
    (task.always if "ALWAYS" in task.step.modifiers else task.next).update(values)


def _set_tolerance(task: Task, percent: float = 100.0) -> None:
    _choose(task, FINE=percent * (1.0 if task.step.word == "FINE" else 10.0))


def _set_speed(task: Task, speed: float, rotary: float | None = None) -> None:
    """Set the program speed, in percent or in mm or inches a second, or the monitor speed."""
    units = [unit for word, unit in _UNITS.items() if word in task.step.modifiers]
    if units:
        speed *= 100.0 * units[0] / task.arm.full.linear_speed
    percent = task.taken("percent", speed)
    if "MONITOR" in task.step.modifiers:
        task.queue.monitor = min(percent, 100.0)
    else:
        _choose(task, SPEED=percent, ROTARY=rotary or (task.always["ROTARY"] if units else percent))


def _set_ramps(task: Task, *ramps: float | None) -> None:
    """Set the accelerations; those out of range are clipped, as the manual says."""
    for name, percent in zip(("UP", "DOWN"), ramps, strict=False):
        if percent is not None:
            task.always[name] = min(max(percent, 1.0), 1000.0)


def _set_profile(task: Task, profile: float | None = None, *ramps: float | None) -> None:
    task.always["SMOOTH"] = profile or 0.0
    _set_ramps(task, *ramps)


def _configure(task: Task) -> None:
    """Ask for a configuration at the next motion that is no line."""
    is_second, part = divmod(CONFIGURATIONS.index(task.step.word), 3)
    task.wanted[part] = bool(is_second)


# Signals and time.


def _set_hand(task: Task, state: str = "") -> None:
    """Set the hand when the next motion begins."""
    task.at_start.append(partial(task.cell.switch, *_HAND[state or task.step.word[0]]))


def _set_hand_now(task: Task) -> Waits:
    """Set the hand when this motion has ended, and wait."""
    word = task.step.word
    yield from _break(task)
    task.cell.switch(*_HAND[word[0]])
    yield from _wait_event(task, None, task.hand_time)


def _wait_event(task: Task, _: Tree = None, seconds: float = 0.0) -> Waits:
    latest = task.cell.time + seconds - 1e-9
    return task.until(lambda: task.cell.time >= latest, "time")


def _wait(task: Task, condition: Tree = None) -> Waits:
    """Wait until an expression is true, or for a beat."""
    if condition is None:
        yield "the next beat"
    else:
        yield from task.until(lambda: task.taken("real", condition) != 0.0, "WAIT")


def _set_bits(task: Task, value: int, first: int, count: int = 1) -> None:
    task.cell.switch(
        *(bit + first if value >> bit & 1 else -first - bit for bit in range(min(count, 24)))
    )


def _reset(task: Task) -> None:
    task.cell.switch(*(-signal for signal in task.cell.outputs()))


def _set_timer(task: Task, value: float, number: int) -> None:
    task.timers[number] = task.cell.time - value


def _react(task: Task, signal: int, name: str, priority: float = 1.0) -> None:
    """Call a program when a signal changes; REACTI ends the motion, too."""
    task.program(name)
    stops = task.step.word == "REACTI"
    task.reactions[signal] = Reaction(name, priority, stops, task.cell.is_on(signal))


def _react_to_errors(task: Task, name: str = "") -> None:
    task.on_error = name


def _ignore(task: Task, signal: int, _: object = None) -> None:
    task.reactions.pop(signal, None)


def _lock(task: Task, priority: float) -> None:
    task.lock = priority


def _set_switches(task: Task, *names: str) -> Waits:
    """Switch system switches on or off; the power comes when the arm stands."""
    on = task.step.word == "ENABLE"
    cell = task.cell
    if "POWER" in names:
        if on:
            yield from _end_of_stop(task)
        cell.power(on)
    cell.switches = cell.switches.union(names) if on else cell.switches.difference(names)


def _set_parameter(task: Task, value: Value, name: str) -> None:
    """Set a system parameter; HAND.TIME has an effect here."""
    if name == "HAND.TIME":
        task.hand_time = task.taken("seconds", value)  # type: ignore[arg-type]  # a value is a tree of its own


# Text.


def _show(task: Task, *items: Value) -> None:
    text, ends = written(task, items)
    task.cell.show(text, task.cell.time, ends)


def _ask(task: Task, question: str, *targets: Variable) -> Waits:
    """Ask for a line, and store its numbers or its text."""
    try:
        answer = task.cell.ask(question)
    except EOFError:
        raise VplusError(
            "Unexpected end of file", f"no line of input for {task.step.word}"
        ) from None
    while answer is None:
        yield "a line of input"
        answer = task.cell.ask("")
    parts = [*typed_numbers(answer), *[""] * len(targets)]
    for target, part in zip(targets, parts, strict=False):
        target.store(answer if target.name[0] == "$" else bounded(number_of(part)))


def typed_numbers(line: str) -> list[str]:
    """Return the parts of a line, which commas separate, or blanks between two numbers."""
    return _BETWEEN.split(line.strip())


def _attach(task: Task, unit: Tree = None, *_: object) -> None:
    """Give the program a unit of input and output, a free one where an undefined variable stands for it."""
    if isinstance(unit, Reference) and task.variable(unit).value is None:
        free = next(number for number in count(10) if number not in task.units)
        task.variable(unit).store(float(free))
    task.units |= {task.taken("real?", unit)} - _NO_UNITS


def _detach(task: Task, unit: float | None = None, *_: object) -> None:
    task.units -= {unit}


_CONTROL: Final[dict[str, Any]] = {
    "IF_THEN WHILE UNTIL  real": lambda task, condition: task.jump(condition == 0.0),
    "IF_GOTO  real tree": lambda task, condition, _: task.jump(condition != 0.0),
    "ELSE ANY GOTO VALUE EXIT NEXT  tree*": lambda task, *_: task.jump(),
    "END": _end,
    "FOR  variable real real real?": _begin_for,
    "CASE  folded": _choose_case,
    "CALL CALLS  text tree*": Task.call,
    "RETURN RETURNE": _return,
    "STOP HALT": _stop,
    "PAUSE": _pause,
    "DO": _nothing,
}
_MOTIONS: Final[dict[str, Any]] = {
    "MOVE MOVES  location": _move,
    "MOVET MOVEST  location real": _move,
    "APPRO APPROS  location real": _approach,
    "DEPART DEPARTS  real": _depart,
    "ALIGN": _align,
    "DRIVE  joint real percent": _drive,
    "JMOVE  real? real? real? real? real? real?": _move_joints,
    "READY": lambda task: _issue(task, task.arm.ready),
    "DELAY  seconds": _delay,
}
_ACTIONS: Final[dict[str, Any]] = {
    **{words: _from_rest(action) for words, action in _MOTIONS.items()},
    "=  any variable": _assign,
    "SET=  location variable": _set,
    "HERE  variable": _here,
    "JHERE  variable variable*": _joints_here,
    "DECOMPOSE=  location tree": _decompose,
    "TOOL  place?": _set_tool,
    "BASE  real? real? real? real?": _set_base,
    "BREAK": _break,
    "BRAKE": lambda task: task.queue.stop(),
    " ".join(CONFIGURATIONS): _configure,
    "CPON": partial(_choose, CP=1.0),
    "CPOFF": partial(_choose, CP=0.0),
    "NULL": partial(_choose, NULL=1.0),
    "NONULL": partial(_choose, NULL=0.0),
    "FINE COARSE  percent?": _set_tolerance,
    "SPEED  real percent?": _set_speed,
    "ACCEL  real? real?": _set_ramps,
    "ACCEL()  real? real? real?": _set_profile,
    "DURATION  seconds": lambda task, seconds: _choose(task, DURATION=seconds),
    "OPEN CLOSE RELAX": _set_hand,
    "OPENI CLOSEI RELAXI": _set_hand_now,
    "SIGNAL  integer integer*": lambda task, *signals: task.cell.switch(*signals),
    "BITS=  integer integer integer?": _set_bits,
    "RESET": _reset,
    "WAIT  tree?": _wait,
    "WAIT.EVENT  tree? seconds?": _wait_event,
    "TIMER=  real integer": _set_timer,
    "REACT REACTI  integer name real?": _react,
    "REACTE  name?": _react_to_errors,
    "IGNORE  integer any?": _ignore,
    "LOCK  real": _lock,
    "ENABLE DISABLE  name name*": _set_switches,
    "PARAMETER=  any name": _set_parameter,
    "TYPE  any*": _show,
    "PROMPT  text variable*": _ask,
    "READ()  any variable*": lambda task, _, *targets: _ask(task, "", *targets),
    "WRITE()  any any*": lambda task, _, *items: _show(task, *items),
    "ATTACH()  tree any?": _attach,
    "DETACH()  real? any?": _detach,
    "AUTO LOCAL GLOBAL  tree*": _nothing,
    "SELECT=  tree*": _nothing,
    "ATTACH DETACH MULTIPLE SINGLE OVERLAP NOOVERLAP": _nothing,
}
CONTROL = entries(_CONTROL)
INSTRUCTIONS = CONTROL | entries(_ACTIONS)
REFUSED = {word: reason for words, reason in _REFUSED.items() for word in words.split()}
"""Instructions and functions that are not there, and why."""
