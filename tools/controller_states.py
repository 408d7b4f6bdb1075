"""Write the table in docs/reference/controller_states.md: each event in each state of the controller, and its answer.

    python -m tools.controller_states

A controller whose motors stand still is brought into each state and given each event.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.law.cs7b import CS7B, DriveFault
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.servo.events import (
    Begin,
    Cancel,
    Fault,
    GiveUp,
    LawChange,
    Offer,
    Streamed,
    TorqueSwitch,
)
from rx90_controller.servo.servo import MotorStates, Outputs
from rx90_controller.servo.states import Releasing, ServoState
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.request import GoalOptions, GoalTolerances, State, TrajectoryRequest
from rx90_controller.trajectory.stream import POSITION, SetPoints

PAGE = Path(__file__).resolve().parent.parent / "docs/reference/controller_states.md"
_TABLE = re.compile(r"(<!-- table -->\n).*?(<!-- end -->)", re.DOTALL)
_MOVE = 0.01  # rad, in a second


class Bench:
    """A servo loop whose motors stand still, and what it says."""

    def __init__(self, cs7b: CS7B) -> None:
        cs7b.reset(np.zeros(len(cs7b.joint_names)))
        self.cs7b = cs7b
        self.lines: list[str] = []
        outputs = SimpleNamespace(
            ready="ready",
            wake=lambda: self.loop.report(),  # noqa: PLW0108 - the loop is made after it
            publish=lambda _: None,
            accepted=lambda *_: None,
            info=self.lines.append,
            error=self.lines.append,
        )
        self.loop = ServoLoop(cs7b, cast(Outputs, outputs), 60.0)
        self.offered: list[TrajectoryRequest] = []
        self._rest = np.zeros(len(cs7b.joint_names))

    def begin(self) -> None:
        """Let states come that follow no others."""
        self.loop.post(Begin(self.cs7b.tick * self.cs7b.rates.period_ns, self._rest))

    def tick(self, count: int = 1) -> None:
        """Run ticks of the position loop."""
        for _ in range(count * self.cs7b.rates.ratio):
            stamp = self.cs7b.tick * self.cs7b.rates.period_ns
            self.loop.step(stamp, MotorStates(stamp, self._rest, self._rest))
            self.loop.after_command(stamp)

    def offer(self, *, is_goal: bool, stop: bool = False) -> None:
        """Offer a goal or a trajectory, from where the arm is, or a stop."""
        names = self.cs7b.joint_names
        target = (self.cs7b.setpoint[0] + _MOVE)[None]
        points = None if stop else TrajectoryPoints(np.ones(1), target, None, None)
        message = SimpleNamespace(header=SimpleNamespace(frame_id=""))
        tolerances = GoalTolerances.of_parameters(names)
        request = TrajectoryRequest(message, points, None, tolerances, GoalOptions(), is_goal)
        request.on_result = (lambda: None) if is_goal else None
        self.offered.append(request)
        self.loop.post(Offer(request))

    def stream(self) -> None:
        """Send a set-point where the arm is."""
        position: Array = self.cs7b.setpoint[:1]
        values = np.stack([position, np.nan * position], axis=1)
        every = np.ones(len(self._rest), dtype=np.bool_)
        self.loop.post(Streamed(SetPoints(POSITION, 0, np.array([0.03]), values, every), "a topic"))

    def cancel(self) -> None:
        """Take back all goals."""
        for request in self.offered:
            if request.is_goal:
                self.loop.post(Cancel(request))

    def fault(self) -> None:
        """Let the supervision find a joint too fast."""
        fault = DriveFault(self.cs7b.joint_names[0], "speed", 9.0, 5.0, "rad/s", 0.0)
        self.loop.post(Fault(fault, self._rest))


def _then(*steps: Callable[[Bench], None]) -> Callable[[Bench], None]:
    def play(bench: Bench) -> None:
        for step in steps:
            step(bench)

    return play


def _switch(on: bool, by_node: bool = False) -> Callable[[Bench], None]:
    return lambda bench: bench.loop.post(TorqueSwitch(on, by_node))


def _goal(bench: Bench) -> None:
    bench.offer(is_goal=True)


def _trajectory(bench: Bench) -> None:
    bench.offer(is_goal=False)


_MOVING = _then(Bench.begin, _goal, lambda bench: bench.tick(300))
SITUATIONS: Mapping[str, Callable[[Bench], None]] = {
    "unstarted, off": _switch(on=False),
    "unstarted, on; a goal waits": _goal,
    "releasing, off": _then(_MOVING, _switch(on=False)),
    "releasing, on; a goal waits": _then(_MOVING, _switch(on=False), _switch(on=True), _goal),
    "off": _then(Bench.begin, _switch(on=False), Bench.tick),
    "off, inactive": _then(Bench.begin, _switch(on=False, by_node=True), Bench.tick),
    "holding": _then(Bench.begin, Bench.tick),
    "following a goal": _MOVING,
    "following a trajectory": _then(Bench.begin, _trajectory, lambda bench: bench.tick(300)),
    "streaming": _then(Bench.begin, Bench.tick, Bench.stream, Bench.tick),
    "stopping": _then(_MOVING, Bench.cancel),
}
"""How the controller comes into each state."""
EVENTS: Mapping[str, Callable[[Bench], None]] = {
    "tick": Bench.tick,
    "ticks of a second": lambda bench: bench.tick(1000),
    "goal": _goal,
    "trajectory": _trajectory,
    "stop": lambda bench: bench.offer(is_goal=False, stop=True),
    "set-point": Bench.stream,
    "cancel": Bench.cancel,
    "goal given up": lambda bench: bench.loop.post(GiveUp("the controller ends")),
    "torque off": _switch(on=False),
    "torque on": _switch(on=True),
    "node deactivated": _switch(on=False, by_node=True),
    "node activated": _switch(on=True, by_node=True),
    "fault": Bench.fault,
    "states begin": Bench.begin,
    "law changed": lambda bench: bench.loop.post(LawChange(bench.cs7b.law.copy(), lambda _: None)),
}


def answers(cs7b: CS7B) -> dict[str, dict[str, str]]:
    """Return the answer to each event in each state, as in the table, by event and state."""
    return {
        event: {state: answer(Bench(cs7b), state, event) for state in SITUATIONS}
        for event in EVENTS
    }


def answer(bench: Bench, state: str, event: str) -> str:
    """Return the next state, and what has become of the request in the event, and of what was there before."""
    SITUATIONS[state](bench)
    if not bench.loop.state.started and "tick" in event:
        return "-"
    before = list(bench.offered)
    ended = [request.reason for request in before]
    refused = bench.loop.servo.rejected
    bench.lines.clear()
    EVENTS[event](bench)
    said = []
    if bench.loop.servo.rejected > refused:
        said.append("refused")
    for request in bench.offered[len(before) :]:
        if request.state is not State.ABORTED:
            said.append("waits" if not bench.loop.state.torque else "accepted")
    for request, reason in zip(before, ended, strict=True):
        if request.reason and not reason:
            said.append(f"{request.kind} {request.state.value}")
    if any(line.startswith("stream ended") for line in bench.lines):
        said.append("stream ended")
    return "; ".join([_name(bench.loop.state), *said])


def _name(state: ServoState) -> str:
    if isinstance(state, Releasing):
        return f"{state.name}, {'on' if state.switch.on else 'off'}"
    return state.name


def table(found: Mapping[str, Mapping[str, str]]) -> str:
    """Return answers as a table: a row for each state, with the events that change something."""
    rows = "| in state | events: next state; requests |\n|---|---|\n"
    for state in SITUATIONS:
        unchanged = state.partition(";")[0].partition(" a ")[0].removesuffix(", inactive")
        events_of: dict[str, list[str]] = {}
        for event in found:
            events_of.setdefault(found[event][state], []).append(event)
        effects = [
            f"{', '.join(names)}: {then}"
            for then, names in events_of.items()
            if then not in {"-", unchanged}
        ]
        rows += f"| **{state}** | {'<br>'.join(effects)} |\n"
    return rows


def page(text: str, found: Mapping[str, Mapping[str, str]]) -> str:
    """Return the page's text with this table."""
    return _TABLE.sub(lambda match: f"{match[1]}\n{table(found)}\n{match[2]}", text)


if __name__ == "__main__":
    from rx90_emulator.loop.setup import Setup

    arm = Setup.load().cs7b()
    arm.warm_up()
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), answers(arm)), encoding="utf-8")
