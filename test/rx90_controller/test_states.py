"""Each event in each state of the controller, and random sequences of events by the thousand."""

import copy
from typing import Any

import numpy as np
import pytest
from goal_arm import LIMITS, Law, message
from joint_moves import HOME, NAMES, PERIOD, ZERO, stamp, trajectory
from numpy.random import Generator
from servo_rig import Surroundings

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.law.cs7b import DriveFault
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.servo.events import Begin, Cancel, GiveUp, Offer, Streamed, TorqueSwitch
from rx90_controller.servo.servo import MotorStates
from rx90_controller.trajectory import TrajectoryGenerator
from rx90_controller.trajectory.request import (
    GoalOptions,
    GoalTolerances,
    JoinedAhead,
    State,
    TrajectoryRequest,
    check_request,
)
from rx90_controller.trajectory.stream import INTERFACES, SetPoints
from rx90_emulator.loop.setup import Setup
from tools.controller_states import EVENTS, PAGE, SITUATIONS, answers, page

SEQUENCES, LENGTH = 6000, 6
TOLERANCES = GoalTolerances.of_parameters(NAMES)

REFUSED = dict.fromkeys(("goal", "trajectory", "stop", "set-point"), "= refused")
PREEMPTED = dict.fromkeys(("goal", "trajectory", "stop"), "= waits; goal aborted")
TAKEN = dict.fromkeys(("goal", "trajectory", "stop"), "following; accepted")
SWITCHED = {"torque off": "releasing, off", "node deactivated": "releasing, off"}
POWERED = {**TAKEN, **SWITCHED, "set-point": "streaming", "fault": "off", "states begin": "holding"}
EXPECTED: dict[str, dict[str, str]] = {
    "unstarted, off": {
        "tick": "-", "ticks of a second": "-", **REFUSED, "trajectory": "= waits", "stop": "= waits",
        "torque on": "unstarted, on", "node activated": "unstarted, on", "states begin": "off",
    },
    "unstarted, on; a goal waits": {
        "tick": "-", "ticks of a second": "-", **PREEMPTED, "set-point": "= refused", "cancel": "= goal canceled",
        "goal given up": "= goal aborted", "torque off": "unstarted, off; goal aborted",
        "node deactivated": "unstarted, off; goal aborted", "states begin": "following",
    },
    "releasing, off": {
        "tick": "off", "ticks of a second": "off", **REFUSED, "torque on": "releasing, on",
        "node activated": "releasing, on", "states begin": "off",
    },
    "releasing, on; a goal waits": {
        "tick": "following", "ticks of a second": "following", **PREEMPTED, "set-point": "= refused",
        "cancel": "= goal canceled", "goal given up": "= goal aborted", "torque off": "releasing, off; goal aborted",
        "node deactivated": "releasing, off; goal aborted", "states begin": "holding; goal aborted",
    },
    "off": {**REFUSED, **SWITCHED, "torque on": "holding", "node activated": "holding"},
    "off, inactive": {**REFUSED, **SWITCHED, "node activated": "holding"},
    "holding": POWERED,
    "following a goal": {
        **{event: f"{end}; goal aborted" for event, end in POWERED.items()},
        "ticks of a second": "holding; goal succeeded", "cancel": "stopping; goal canceled",
        "goal given up": "stopping; goal aborted",
    },
    "following a trajectory": {**POWERED, "ticks of a second": "holding"},
    "streaming": {
        **{event: f"{end}; stream ended" for event, end in POWERED.items()}, "set-point": "=",
        "ticks of a second": "holding; stream ended",
    },
    "stopping": {**POWERED, "ticks of a second": "holding"},
}  # fmt: skip
"""By hand, from docs/reference/joint_trajectory_controller.md; `=` and what is missing: the state stays."""


def test_each_event_in_each_state_has_its_answer_and_the_page_says_so(shipped: Setup) -> None:
    """All 165 pairs, of a controller that is run; the same are on the page of the reference."""
    found = answers(shipped.cs7b())
    assert list(SITUATIONS) == list(EXPECTED)
    for event in EVENTS:
        for state in SITUATIONS:
            same = "off" if state == "off, inactive" else state.partition(";")[0].partition(" a ")[0]
            expected = EXPECTED[state].get(event, "=").replace("= ", f"{same}; ").replace("=", same)
            assert found[event][state] == expected, (state, event)
    text = PAGE.read_text(encoding="utf-8")
    assert text == page(text, found), "run python -m tools.controller_states"


def damage(random: Generator, sent: Any) -> None:
    point = sent.points[random.integers(len(sent.points))]
    strange = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300]
    match random.integers(0, 6):
        case 0:
            point.positions[0] = random.choice(strange)
        case 1:
            point.velocities = [random.choice(strange)] * len(sent.joint_names)
        case 2:
            point.positions.append(0.0)
        case 3:
            sent.joint_names[0] = random.choice(["", "elbow", NAMES[0], "\0"])
        case 4:
            sent.points.append(copy.deepcopy(point))
        case _:
            point.time_from_start = stamp(random.choice([-1.0, 0.0, 1e-9, 3e9]))


class Drives(Law):
    """A law without torques, at one tick a millisecond; the motors are where the set-points are."""

    def __init__(self) -> None:
        super().__init__(TrajectoryGenerator(LIMITS, PERIOD, HOME))
        self.broken = False

    @property
    def tick(self) -> int:
        return self.position_tick

    def reset(self, position: Array, tick: int) -> None:
        self.fault = None
        self.setpoint = np.array([position, ZERO, ZERO])
        self.trajectory.reset(position)
        self.position_tick = tick

    release = reset

    def step(self, *_: object) -> None:
        super().step()
        if self.broken:
            self.fault = DriveFault(NAMES[0], "speed", 9.0, 5.0, "rad/s", 0.0)
            self.broken = False


class Play:
    """A controller given random events, and what must hold; `on`: ticks give torque, by the events alone."""

    def __init__(self, random: Generator) -> None:
        self.random, self.law = random, Drives()
        law: Any = self.law
        self.loop = ServoLoop(law, Surroundings(), 60.0, 1)
        self.goals: list[TrajectoryRequest] = []
        self.ends: list[TrajectoryRequest] = []
        self.setpoints: list[Array] = [self.law.setpoint]
        self.started, self.on, self.released, self.active = False, True, False, True

    def begin(self) -> None:
        self.loop.post(Begin(int(self.random.integers(0, 10)) * 1_000_000, self.law.setpoint[0]))
        self.started, self.released = True, False
        self.setpoints = [self.law.setpoint]

    def ticks(self) -> None:
        """Run ticks: there is torque if it is on, but in the first one after it was off."""
        if not self.started:
            return
        broken = self.random.random() < 0.1
        for i in range(count := int(self.random.integers(1, 30))):
            self.law.broken = broken and i == count - 1 and self.on and not self.released
            expected = self.on and not self.released and not self.law.broken
            self.on = self.on and not self.law.broken
            states = MotorStates(self.law.tick * 1_000_000, self.law.setpoint[0], ZERO)
            assert self.loop.step(states.stamp_ns, states) == expected
            self.loop.after_command(states.stamp_ns)
            self.released = False
            if expected:
                self.setpoints.append(self.law.setpoint)
            else:
                self.check()
                self.setpoints = [self.law.setpoint]
        self.check()

    def check(self) -> None:
        path = np.array(self.setpoints)
        assert (np.abs(path[:, 0]) <= LIMITS.upper).all()
        assert (np.abs(path[:, 1]) <= LIMITS.velocity * (1 + 2e-3)).all()
        most = LIMITS.acceleration * PERIOD * (1 + 2e-3)
        assert (np.abs(np.diff(path[:, 1], axis=0)) <= most).all()
        moved = np.diff(path[:, 0], axis=0) - 0.5 * PERIOD * (path[1:, 1] + path[:-1, 1])
        assert (np.abs(moved) <= 0.25 * PERIOD * most).all()
        self.setpoints = [path[-1]]

    def switch(self) -> None:
        on, by_node = bool(self.random.random() < 0.6), bool(self.random.random() < 0.3)
        self.loop.post(TorqueSwitch(on, by_node))
        self.active = self.active or by_node if on else self.active and not by_node
        self.on = on and self.active
        self.released = self.released or (not on and self.started)

    def offer(self) -> None:
        """Offer a goal, a trajectory or a stop, many of which cannot be followed: then the motion stays."""
        request = self.request()
        if request is None:
            return
        if request.is_goal:
            request.on_result = lambda: self.ends.append(request)
            self.goals.append(request)
        if request.points is not None and self.loop.state.torque and self.random.random() < 0.2:
            joined = JoinedAhead(request, self.law.trajectory, self.law.tick)
            joined.compute()
            self.ticks()
            self.loop.post(Offer(request, joined))
        if request.state is State.RECEIVED:
            revision = self.law.trajectory.revision
            self.loop.post(Offer(request))
            followed = request.state is not State.ABORTED and self.loop.state.torque
            assert (self.law.trajectory.revision != revision) == followed
        assert "\n" not in request.reason

    def request(self) -> TrajectoryRequest | None:
        """Return a request with or without points; None for a message that is refused, with a reason, by itself."""
        random = self.random
        options = GoalOptions(**{name: bool(random.integers(0, 2)) for name in GoalOptions.model_fields})
        names = list(random.permutation(NAMES))[: random.integers(1, 12) if options.allow_partial_joints_goal else 6]
        n, kind, is_goal = len(names), random.integers(0, 3), bool(random.random() < 0.6)
        times = np.cumsum(random.uniform(0.02, 0.6, random.integers(int(is_goal), 5)))
        scale = random.choice([0.02, 0.1, 0.5])
        places, speeds, bends = random.uniform(-scale, scale, (3, len(times), n))
        if not options.allow_nonzero_velocity_at_trajectory_end or random.random() < 0.5:
            speeds[-1:] = 0.0
        places += [HOME[NAMES.index(name)] for name in names]
        start = max(0.0, self.law.tick * PERIOD + random.uniform(-0.1, 0.1)) if random.random() < 0.4 else 0.0
        rows = (speeds[: len(times) * (kind > 0)], bends[: len(times) * (kind > 1)])
        sent = trajectory(times, places, *rows, start=start, names=names)
        if len(times) and random.random() < 0.2:
            damage(random, sent)
        try:
            return check_request(sent, TOLERANCES, options, 1000, message() if is_goal else None)
        except TrajectoryError as error:
            reason = str(error)
        assert reason
        assert "\n" not in reason
        return None

    def stream(self) -> None:
        interface, far = INTERFACES[self.random.integers(2)], self.random.choice([0.001, 1.0])
        value = self.law.setpoint[0] * (interface == "position") + far * self.random.normal(size=6)
        points = np.stack([value, np.nan * value])[None]
        self.loop.post(Streamed(SetPoints(interface, 0, np.array([0.03]), points, np.ones(6, dtype=bool)), "a topic"))

    def end(self) -> None:
        if self.goals and self.random.random() < 0.7:
            self.loop.post(Cancel(self.goals[self.random.integers(len(self.goals))]))
        else:
            self.loop.post(GiveUp("the controller ends", bool(self.random.random() < 0.5)))

    def run(self) -> None:
        """Play events; at most one goal has no end yet, the state's, and in the end each has one."""
        steps = [self.ticks] * 3 + [self.offer] * 2 + [self.switch, self.stream, self.end, self.begin]
        for _ in range(LENGTH):
            steps[self.random.integers(len(steps))]()
            self.loop.report()
            running = [goal for goal in self.goals if not goal.reason]
            assert running == [self.loop.state.request] * self.loop.state.has_goal
            assert self.ends == [goal for goal in self.ends if goal.reason]
        self.loop.post(TorqueSwitch(on=False))
        self.loop.report()
        assert sorted(map(id, self.ends)) == sorted(map(id, self.goals))


@pytest.mark.slow
def test_random_sequences_of_events_keep_what_must_hold() -> None:
    """Each goal is answered once, no set-point is beyond the limits, refused requests change nothing, off is off."""
    for seed in range(SEQUENCES):
        Play(np.random.default_rng(seed)).run()
