"""The tabs that move the arm and ask the nodes without waiting for them: sliders, a line, services, friction."""

from __future__ import annotations

import html
import math
import time
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.arm_watch import JointSample
from rx90_common.exchange.client_node import (
    ClientNode,
    NodeWatch,
    ServiceCalls,
    ServiceRequest,
    parameter_request,
    state_request,
    subscribe_log,
    transition_request,
)
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.lines.plan import Approach
from rx90_controller.lines.task import TOOL_DOWN, USUAL_ACCELERATION, USUAL_SPEED, LineTask, TipTask
from rx90_controller.node.trajectory_client import TrajectoryClient, enable_request
from rx90_controller.trajectory import JointLimits, TrajectoryPoints
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.forms import ElementForm, LineForm, LinePreview
from rx90_emulator.view.page import Page, block, from_user, on_change, put
from rx90_sim.node.simulation_client import pause_request, reset_request, step_request

TIMEOUT = 5.0
"""The longest wait for an answer, s."""
_GRAPH_PERIOD = 0.5  # s from one look at which nodes there are to the next
_MAX_MESSAGES = 5  # that are taken in one step at most, so that the page goes on
_TO_UNCONFIGURED = {  # transitions from each state to unconfigured
    "active": ("deactivate", "cleanup"),
    "inactive": ("cleanup",),
    "unconfigured": (),
}
_Requests = Generator[ServiceRequest, str | None, None]
_Ended = Callable[[str, bool], None]


class Operator:
    """Sends requests to the nodes. Every method returns at once; `step` handles the answers.

    Args:
        client: the node that asks them.
        controller: name of the controller node, relative or absolute; the simulation is in its namespace.
        heard: takes the name of a node, a line, and whether it is a refusal or a failure.
        timeout: the longest wait for an answer, s.

    Attributes:
        simulation, controller: the nodes' names.
    """

    def __init__(
        self, client: ClientNode, controller: str, heard: Callable[[str, str, bool], None], timeout: float = TIMEOUT
    ) -> None:
        self.simulation, self.controller = f"{controller[: controller.rfind('/') + 1]}rx90_sim", controller
        self._heard, self._client = heard, replace(client, timeout=timeout)
        self._calls = ServiceCalls(self._client)
        self._trajectories = TrajectoryClient(self._client, controller)
        nodes = self.simulation, self.controller
        self._watches = [NodeWatch(self._client, self._calls, name) for name in nodes]
        subscribe_log(self._client, nodes, self._log_line)
        self._answer_by: float | None = None  # when the controller must have said something of a trajectory
        self._next_look = 0.0

    @property
    def states(self) -> dict[str, str]:
        """Return the lifecycle states of simulation and controller by their names; empty for a node that is absent."""
        return {self.simulation: self._watches[0].state, self.controller: self._watches[1].state}

    def step(self, now: float) -> None:
        """Handle messages and answers; to be called often, with the steady clock's time, s."""
        for _ in range(_MAX_MESSAGES):
            self._client.spin(0.0)
        self._calls.look()
        if now >= self._next_look:
            self._next_look = now + _GRAPH_PERIOD
            for watch in self._watches:
                watch.look()
        if self._answer_by is not None and now >= self._answer_by:
            self._answer_by = None
            text = f"has said nothing of the trajectory within {self._client.timeout:g} s"
            self._heard(self.controller, text, True)

    def ask(self, request: ServiceRequest) -> None:
        """Call a service; its answer, or that there is none, goes to `heard`."""

        def only() -> _Requests:
            yield request

        self._ask_in_turn(request.service.rpartition("/")[0], only())

    def send(self, joints: tuple[str, ...], points: TrajectoryPoints | None) -> None:
        """Send a trajectory that starts now, None to stop the arm; the controller's log line goes to `heard`."""
        try:
            self._trajectories.offer(joints, points)
            self._answer_by = self._answer_by or time.monotonic() + self._client.timeout
        except ExchangeError as error:
            self._heard(self.controller, str(error), True)

    def start_again_with(self, parameter: str, value: str, ended: _Ended) -> None:
        """Set a parameter of the simulation that is read at its start, and start it again, at time 0.

        `ended` takes how that went and whether it went wrong.
        """
        node = self.simulation

        def requests() -> _Requests:
            # Asked for: what was heard of its transitions may be older than the answer to the last one.
            state = yield state_request(node)
            if state not in _TO_UNCONFIGURED:
                raise ExchangeError(f"its state is {state}; accepted: a simulation that runs")
            yield from (transition_request(node, label) for label in _TO_UNCONFIGURED[state])
            yield parameter_request(node, parameter, value)
            yield from (transition_request(node, label) for label in ("configure", "activate"))

        def tell(text: str, wrong: bool) -> None:
            ended(f"{node} {'is not started again' if wrong else 'runs again, from time 0'}: {text}", wrong)

        self._ask_in_turn(node, requests(), tell)

    def _ask_in_turn(self, node: str, requests: _Requests, ended: _Ended = lambda _text, _wrong: None) -> None:
        """Call services one after the other while they succeed; the last answer, or the first no, goes to `heard`.

        `requests` is sent each answer.
        """

        def proceed(outcome: str | ExchangeError) -> None:
            try:
                if isinstance(outcome, ExchangeError):
                    raise outcome
                request = requests.send(outcome or None)
            except (StopIteration, ExchangeError) as end:
                wrong = isinstance(end, ExchangeError)
                text = str(end if wrong else outcome)
                self._heard(node, text, wrong)
                ended(text, wrong)
            else:
                self._calls.ask(request, proceed)

        proceed("")

    def _log_line(self, node: str, line: str, wrong: bool) -> None:
        if node == self.controller:
            self._answer_by = None
        self._heard(node, line, wrong)


_STEP = 0.1  # deg
_INTERVAL = 0.2  # s from one trajectory to the next while a slider is dragged
_DISPLAY_LATENCY = 2.0  # s; the longest that what the page shows takes to a browser
_SETTLED = 0.5  # s after the last change by a user, who may type on before
ARRIVED = 2e-3
"""How near to where it was sent the arm counts as there, rad."""
_STUCK_AFTER = 2.0  # s without a motion until a slider shows the arm again, instead of where it was sent
_MOVED = 1e-6  # rad
_ROUNDING = 1e-6  # steps: a limit of whole degrees is one of the ends
_MIN_DURATION, _DURATION_FACTOR = 0.02, 1.15  # s; from one try to the next
_SAMPLES = np.linspace(0.0, 1.0, 33)[:-1]  # the last one would be the rest behind the end
_JOG_LIMITS = Approach()


def jog(position: Array, velocity: Array, target: Array, limits: JointLimits) -> TrajectoryPoints:
    """Return a quintic move to rest at a target, as short as the speed and acceleration of an approach allow.

    It will begin at the controller's set-point, of which the arm's own state is a good guess: the margin up to the
    controller's limits is for the difference.

    Args:
        position: of the arm, rad, shape (n,).
        velocity: rad/s, shape (n,).
        target: rad, shape (n,).
        limits: the controller's.
    """
    # Slower than it is, it cannot be at once.
    top = np.maximum(_JOG_LIMITS.speed * limits.velocity, np.abs(velocity)) * (1.0 + _ROUNDING)
    most = np.minimum(_JOG_LIMITS.acceleration, limits.acceleration)
    rest = np.zeros((1, len(target)))
    ends, speeds = np.stack([position, target]), np.vstack([velocity, rest])
    duration = _MIN_DURATION
    while True:
        motion = interpolate(np.array([0.0, duration]), ends, speeds, np.zeros_like(ends))
        sampled = np.abs(motion.sample(_SAMPLES * duration))
        if (sampled[:, 1] <= top).all() and (sampled[:, 2] <= most).all():
            return TrajectoryPoints(np.array([round(duration, 3)]), target[None], rest, rest)
        duration *= _DURATION_FACTOR


class JogSliders:
    """Six sliders in degrees, on whole steps within the joint limits.

    Args:
        page: to build in, within a tab.
        limits: the controller's.
        send: has a trajectory followed from now on.
    """

    def __init__(self, page: Page, limits: JointLimits, send: Callable[[TrajectoryPoints], None]) -> None:
        self._limits, self._send = limits, send
        self._arm: JointSample | None = None
        # Where the joints were sent, rad, and whether they have come there; where the arm was last seen, and moved.
        self._target: Array | None = None
        self._arrived = False
        self._arm_was: Array | None = None
        self._moved_at = 0.0
        self._unsent, self._sent_at = False, -math.inf  # whether the target is still to be sent; when one was
        self._sliders = []
        lowest = np.ceil(np.degrees(limits.lower) / _STEP - _ROUNDING) * _STEP
        highest = np.floor(np.degrees(limits.upper) / _STEP + _ROUNDING) * _STEP
        for joint, (name, low, high) in enumerate(zip(limits.names, lowest.tolist(), highest.tolist(), strict=True)):
            slider = page.gui.add_slider(f"{name}, deg", low, high, _STEP, min(max(0.0, low), high), disabled=True)
            on_change(slider, partial(self._dragged, joint), page)
            self._sliders.append(slider)
        # What each slider was last seen with: another value is one that a user has just given, and is taken first.
        self._seen = [slider.value for slider in self._sliders]
        self._put_at = [-math.inf] * len(self._sliders)  # when each was last moved by the page
        self._given_at = 0.0  # when one was last moved by a user
        self._unsure: set[int] = set()  # sliders that a user has moved while another value was on its way to the page

    def follow(self, arm: JointSample | None, *, ready: bool) -> None:
        """Send what a user has dragged, and show where the arm is, or where it was sent.

        Without an arm, or a controller that is ready, nothing moves.
        """
        self._arm, now = arm, time.monotonic()
        if self._unsent and now >= self._sent_at + _INTERVAL and arm is not None and self._target is not None:
            self._unsent, self._sent_at = False, now
            self._send(jog(arm.position, arm.velocity, self._target, self._limits))
        if arm is not None:
            for joint, angle in enumerate(np.degrees(self._shown(arm.position, now)).tolist()):
                self._show(joint, angle, now)
        for slider in self._sliders:
            slider.disabled = arm is None or not ready

    def forget(self) -> None:
        """Show the arm again: something else was sent, or the move was refused."""
        self._target = None

    def _shown(self, arm: Array, now: float) -> Array:
        """Return what the sliders show, rad: where the joints are to go, while the arm is on its way, else the arm."""
        if self._arm_was is None or np.abs(arm - self._arm_was).max() > _MOVED:
            self._arm_was, self._moved_at = arm.copy(), max(now, self._moved_at)
        if self._target is not None and np.abs(arm - self._target).max() < ARRIVED:
            self._arrived = True
        elif self._arrived or now - self._moved_at > _STUCK_AFTER:
            self._target = None  # something else has moved it, or it is stuck
        return arm if self._target is None or self._arrived else self._target

    def _show(self, joint: int, angle: float, now: float) -> None:
        """Move a slider to an angle, deg, unless a user has just moved it."""
        slider = self._sliders[joint]
        wanted = min(max(round(angle, 1), slider.min), slider.max)
        if slider.value != self._seen[joint]:
            return
        if joint in self._unsure and now > self._given_at + _SETTLED:
            # Viser sends no value that it takes for shown. Of two that are put in one step the page gets the last.
            self._unsure.remove(joint)
            put(slider, slider.min if wanted != slider.min else slider.max)
        if slider.value != wanted:
            put(slider, wanted)
            self._seen[joint], self._put_at[joint] = wanted, now

    def _dragged(self, joint: int) -> None:
        self._seen[joint] = self._sliders[joint].value
        now = self._given_at = time.monotonic()
        if now < self._put_at[joint] + _DISPLAY_LATENCY:
            self._unsure.add(joint)
        if self._arm is not None:
            # The others go on to where they were sent. One that rests there stays sent there: friction holds it a
            # little beside, and to send it to where it is would move it a little with each jog of another joint.
            target = (self._arm.position if self._target is None else self._target).copy()
            target[joint] = np.radians(self._seen[joint])
            self._target, self._arrived, self._moved_at, self._unsent = target, False, now, True


_PERIOD = 0.1  # s
_REFUSED = "rejected"
_LINES = 6
_ABSENT = "not there: its buttons wait for <code>{}</code> to start"
_ACTIVE, _CONFIGURED = ("active",), ("active", "inactive")


class DoPanel:
    """Tabs "Move" and "Element": jogging, lines, services, a friction element.

    Args:
        page: to build in.
        client: the node that asks the others.
        setup: of the robot that the nodes have, read from files.
        task: its reference line or another path, if there is one.
        arm: returns the newest state of the arm; None before the first one, or when it comes no more.
        controller: name of the controller node, relative or absolute; the simulation is in its namespace.
        on_line: takes a line that was sent.
    """

    def __init__(
        self,
        page: Page,
        client: ClientNode,
        setup: Setup,
        task: TipTask | None,
        arm: Callable[[], JointSample | None],
        controller: str,
        on_line: Callable[[LineTask], None],
    ) -> None:
        self._page, self._arm, self._on_line = page, arm, on_line
        assert setup.files is not None
        robot, limits = setup.robot, setup.controller.limits(setup.robot)
        line = task if isinstance(task, LineTask) else _usual_line(robot)
        self._operator = Operator(client, controller, self._hear)
        self._joints = limits.names
        self._lines: deque[str] = deque(maxlen=_LINES)  # the newest of what the nodes say and of what was refused here
        gui = page.gui
        with page.tab("Move"):
            with gui.add_folder("Straight line"):
                self._line = LineForm(page, robot, limits, line, self._send_line)
            with gui.add_folder("Joints"):
                self._sliders = JogSliders(page, limits, partial(self._operator.send, self._joints))
            self._stop = gui.add_button("Stop the arm", color="red")
            self._stop.on_click(from_user(lambda: self._send(None), page))
            with gui.add_folder("What the nodes say"):
                self._log = gui.add_html(block("nothing yet"))
            with gui.add_folder("Nodes"):
                self._add_buttons()
        with page.tab("Element"):
            self._form = ElementForm(page, FrictionFile.read(setup.files.friction), self._start_with)
        page.every(_PERIOD, self._follow)

    def close(self) -> None:
        """End all threads."""
        self._line.close()
        self._form.close()

    def _add_buttons(self) -> None:
        """Add buttons that are enabled while their node can do what they ask for, and a line that says why not."""
        self._state = self._page.gui.add_html("")
        simulation, controller = self._operator.states
        requests = {
            "Pause": (simulation, pause_request(simulation, paused=True), _CONFIGURED),
            "Run": (simulation, pause_request(simulation, paused=False), _CONFIGURED),
            "Step": (simulation, step_request(simulation), _ACTIVE),
            "Reset to time 0": (simulation, reset_request(simulation), _CONFIGURED),
            "Torque on": (controller, enable_request(controller, on=True), _ACTIVE),
            "Torque off, brakes closed": (controller, enable_request(controller, on=False), _ACTIVE),
        }
        self._buttons = []
        for label, (node, request, accepted) in requests.items():
            button = self._page.gui.add_button(label, disabled=True)
            button.on_click(from_user(partial(self._operator.ask, request), self._page))
            self._buttons.append((button, node, accepted))

    def _follow(self, now: float) -> None:
        self._operator.step(now)
        states, arm = self._operator.states, self._arm()
        for button, node, accepted in self._buttons:
            button.disabled = states[node] not in accepted
        lines: list[str] = []
        missing: list[str] = []
        for node, state in states.items():
            name = html.escape(node)
            lines.append(f"<b>{name}</b> {html.escape(state) or _ABSENT.format(name)}")
            reason = f"{node} is {state}; accepted: in state active" if state else f"there is no {node}"
            missing.append("" if state in _ACTIVE else reason)
        self._state.content = block("<br>".join(lines))
        self._form.follow(missing[0])
        self._stop.disabled = bool(missing[1])
        no_arm = "no joint_states come" if arm is None else ""
        self._line.follow(None if arm is None else arm.position, missing[1] or no_arm)
        self._sliders.follow(arm, ready=not missing[1])

    def _send(self, points: TrajectoryPoints | None) -> None:
        self._sliders.forget()
        self._operator.send(self._joints, points)

    def _send_line(self, preview: LinePreview) -> None:
        self._on_line(preview.task)
        self._send(preview.line.points)

    def _start_with(self, path: str) -> None:
        self._sliders.forget()
        self._operator.start_again_with("friction", path, self._form.tell)

    def _hear(self, node: str, line: str, wrong: bool) -> None:
        colour = "color:#c92a2a" if wrong else ""
        self._lines.appendleft(f'<div style="{colour}"><b>{html.escape(node)}</b> {html.escape(line)}</div>')
        self._log.content = block("".join(self._lines))
        if wrong and _REFUSED in line:
            self._sliders.forget()


def _usual_line(robot: RobotModel) -> LineTask:
    """Return a line for a robot that has none of its own, as far out as half its reach."""
    reach = 0.5 * float(abs(robot.chain.origin).sum(axis=0)[2])
    start, end = (reach, -0.1 * reach, 0.3 * reach), (reach, 0.1 * reach, 0.3 * reach)
    return LineTask(start, end, USUAL_SPEED, USUAL_ACCELERATION, TOOL_DOWN, TOOL_DOWN)
