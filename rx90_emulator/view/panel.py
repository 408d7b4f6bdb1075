"""The tab that moves the arm, locked for each client until it has given the code that the terminal printed.

Viser tells inputs of one client from those of all: what is added to `client.gui` hears messages of that client's
connection alone. All inputs of the page are of that kind, and are made when the client has given the code; each change
is looked at again for who sends it. So a page of another origin, whose messages viser takes, too, reaches none of them.
"""

from __future__ import annotations

import hmac
import html
import itertools
import math
import secrets
import sys
import time
from collections import deque
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

import numpy as np
import viser

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError, LineError
from rx90_common.exchange.arm_watch import JointSample
from rx90_common.exchange.client_node import ClientNode, ServiceCalls, subscribe_log
from rx90_controller.lines.plan import (
    APPROACH_ACCELERATION,
    APPROACH_SPEED,
    LinePlan,
    approached,
)
from rx90_controller.node.trajectory_client import TrajectoryClient, enable_request
from rx90_controller.trajectory import JointLimits, TrajectoryPoints
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.page import Page, block

TRIES = 5
"""Wrong codes of all clients together after which none is taken any more."""
_ALPHABET = "23456789ABCDEFGHJKMNPQRSTUVWXYZ"  # without what looks like 0 or 1
_LENGTH = 8
_LOCKED = "Locked: the code is in the terminal, where rx90 view was started."
_SHUT = f"{TRIES} wrong codes: no further page is unlocked until rx90 view is started again"
_WRONG = "color:#c92a2a"
_PERIOD = 0.1  # s
_LINES = 6
_PAGE = "rx90_view"  # who refuses what the page does not even send, or gets no answer to


class Lock:
    """A code, and how many wrong ones may still be given.

    Attributes:
        code: of 8 characters.
        left: wrong codes that may still be given; 0: no code is taken any more.
    """

    def __init__(self) -> None:
        self.code = "".join(secrets.choice(_ALPHABET) for _ in range(_LENGTH))
        self.left = TRIES

    def opens(self, given: str) -> bool:
        """Tell whether this is the code, and count it where it is not."""
        if not self.left:
            return False
        right = hmac.compare_digest(given.strip().upper().encode(), self.code.encode())
        if not right:
            self.left -= 1
        return right


class ControlPanel:
    """The tab "Move": a line or path, stop, torque, and a slider for each joint.

    Args:
        page: to build in.
        client: the node that asks the others; its timeout is the longest wait for an answer.
        setup: of the robot that the nodes have.
        plan: of the line or path that the page shows, if there is one.
        arm: returns the newest state of the arm; None before the first one, or when it comes no more.
        controller: name of the controller node, relative or absolute.

    Attributes:
        lock: with the code that opens the tab.
    """

    def __init__(
        self,
        page: Page,
        client: ClientNode,
        setup: Setup,
        plan: LinePlan | None,
        arm: Callable[[], JointSample | None],
        controller: str,
    ) -> None:
        self.lock = Lock()
        self._page = page
        self._client = client
        self._plan = plan
        self._arm = arm
        self._controller = controller
        self._set_point_period = setup.rates.position_period
        self._limits = setup.controller.limits(setup.robot)
        self._calls = ServiceCalls(client)
        self._trajectories = TrajectoryClient(client, controller)
        subscribe_log(client, (controller,), self._hear)
        self._jogs = Jogs(self._limits, self._offer)
        # Of clients by their numbers, on viser's thread: what the locked ones are asked by, and the others' sliders.
        self._forms: dict[int, list[Any]] = {}
        self._sliders: dict[int, list[viser.GuiSliderHandle[float]]] = {}
        self._lines: deque[str] = deque(maxlen=_LINES)  # the newest of what the controller says
        self._tab = page.tab("Move")
        with self._tab:
            self._shut = page.gui.add_html("")
            self._said = page.gui.add_html("", order=1e9)  # last
        page.server.on_client_connect(self._admit)
        page.server.on_client_disconnect(self._forget)
        page.every(_PERIOD, self._follow)

    async def _admit(self, client: viser.ClientHandle) -> None:
        """Ask a client that has come for the code."""
        if not self.lock.left:
            return
        with self._tab:
            said = client.gui.add_html(block(_LOCKED))
            code = client.gui.add_text("code", "")
            button = client.gui.add_button("Unlock")
        form: list[Any] = [said, code, button]
        self._forms[client.client_id] = form

        async def unlock(_event: object) -> None:
            if not code.value.strip() or client.client_id not in self._forms:
                return
            if self.lock.opens(code.value):
                del self._forms[client.client_id]
                for part in form:
                    part.remove()
                self._add_inputs(client)
            elif self.lock.left:
                said.content = block(
                    f"{_LOCKED} That was wrong; left for all pages together: {self.lock.left}"
                )
            else:
                self._lock_for_good()

        button.on_click(unlock)

    async def _forget(self, client: viser.ClientHandle) -> None:
        self._forms.pop(client.client_id, None)
        self._sliders.pop(client.client_id, None)

    def _lock_for_good(self) -> None:
        self._shut.content = block(f'<div style="{_WRONG}">Locked: {_SHUT}.</div>')
        for part in itertools.chain(*self._forms.values()):
            part.remove()
        self._forms.clear()
        print(f"rx90 view: {_SHUT}", file=sys.stderr, flush=True)

    def _add_inputs(self, client: viser.ClientHandle) -> None:
        """Add all inputs for a client that has given the code."""
        gui = client.gui
        with self._tab:
            if self._plan is not None:
                send = gui.add_button(f"Send the {self._plan.task.what}")
                send.on_click(self._from_user(lambda _: self._send_line()))
            stop = gui.add_button("Stop the arm", color="red")
            stop.on_click(self._from_user(lambda _: self._send(None)))
            for label, on in (("Torque on", True), ("Torque off, brakes closed", False)):
                gui.add_button(label).on_click(self._from_user(partial(self._switch, on)))
            sliders = []
            for joint, name in enumerate(self._limits.names):
                low, high = self._jogs.ranges[joint]
                slider = gui.add_slider(f"{name}, deg", low, high, _STEP, min(max(0.0, low), high))
                slider.on_update(
                    self._from_user(partial(self._drag, joint), partial(_within, low, high))
                )
                sliders.append(slider)
        self._sliders[client.client_id] = sliders

    def _from_user(
        self, function: Callable[[Any], None], accepts: Callable[[Any], bool] = lambda _: True
    ) -> Callable[[Any], Coroutine[Any, Any, None]]:
        """Return a callback of viser's that hands what an unlocked client gave to a function on the page's thread.

        What the input does not offer is left: a message may hold anything.

        It is a coroutine, because viser calls those in the order of what was done; functions it calls on many threads.
        """

        async def hand_over(event: viser.GuiEvent[Any]) -> None:
            value = event.target.value
            # None: the page has moved a slider
            if event.client_id in self._sliders and accepts(value):
                self._page.later(partial(function, value))

        return hand_over

    def _follow(self, now: float) -> None:
        """Take answers, send what was dragged, and show where the arm is, or where it was sent."""
        for _ in range(_LINES):
            self._client.spin(0.0)
        self._calls.look()
        arm = self._arm()
        if arm is None:
            return
        angles = self._jogs.follow(arm, now)
        if angles is None:
            return
        for sliders in list(self._sliders.values()):
            for slider, angle in zip(sliders, angles, strict=True):
                slider.value = angle  # type: ignore[misc]  # viser's setter does not stand beside its getter

    def _send_line(self) -> None:
        assert self._plan is not None
        arm = self._arm()
        if arm is None:
            self._hear(_PAGE, "no joint_states: does a simulation run?", True)
            return
        try:
            line = approached(self._plan, arm.position, self._limits, self._set_point_period, True)
        except LineError as error:
            self._hear(_PAGE, str(error), True)
        else:
            self._send(line.points)

    def _send(self, points: TrajectoryPoints | None) -> None:
        self._jogs.target = None
        self._offer(points)

    def _offer(self, points: TrajectoryPoints | None) -> None:
        try:
            self._trajectories.offer(self._limits.names, points)
        except ExchangeError as error:
            self._hear(_PAGE, str(error), True)

    def _switch(self, on: bool, _pressed: object) -> None:
        def tell(outcome: str | ExchangeError) -> None:
            wrong = isinstance(outcome, ExchangeError)
            self._hear(_PAGE if wrong else self._controller, str(outcome), wrong)

        self._calls.ask(enable_request(self._controller, on=on), tell)

    def _drag(self, joint: int, angle: float) -> None:
        arm = self._arm()
        if arm is not None:
            self._jogs.drag(arm, joint, angle)

    def _hear(self, node: str, line: str, wrong: bool) -> None:
        style = _WRONG if wrong else ""
        self._lines.appendleft(
            f'<div style="{style}"><b>{html.escape(node)}</b> {html.escape(line)}</div>'
        )
        self._said.content = block("".join(self._lines))


_STEP = 0.1  # deg
_INTERVAL = 0.2  # s from one trajectory to the next while a slider is dragged
_SETTLED = 1.0  # s after a drag until sliders follow the arm again
_AT_REST = 1e-3  # rad/s
_ARRIVED = 2e-3  # rad; how near to where it was sent friction holds the arm
_ROUNDING = 1e-6  # steps: a limit of whole degrees is one of the ends
_MIN_DURATION = 0.02  # s
_DURATION_FACTOR = 1.15  # from one try to the next
_SAMPLES = np.linspace(0.0, 1.0, 33)[:-1]  # the last one would be the rest behind the end


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
    top = np.maximum(APPROACH_SPEED * limits.velocity, np.abs(velocity)) * (1.0 + _ROUNDING)
    most = np.minimum(APPROACH_ACCELERATION, limits.acceleration)
    rest = np.zeros((1, len(target)))
    ends = np.stack([position, target])
    speeds = np.vstack([velocity, rest])
    duration = _MIN_DURATION
    while True:
        motion = interpolate(np.array([0.0, duration]), ends, speeds, np.zeros_like(ends))
        sampled = np.abs(motion.sample(_SAMPLES * duration))
        if (sampled[:, 1] <= top).all() and (sampled[:, 2] <= most).all():
            return TrajectoryPoints(np.array([round(duration, 3)]), target[None], rest, rest)
        duration *= _DURATION_FACTOR


class Jogs:
    """Where dragged sliders send the joints, and what sliders show.

    Args:
        limits: the controller's.
        send: has a trajectory followed from now on.

    Attributes:
        ranges: of each slider, deg: whole steps within the joint's limits.
        target: where the joints were sent, rad, shape (n,); None: nobody has sent them, or they were sent elsewhere.
    """

    def __init__(self, limits: JointLimits, send: Callable[[TrajectoryPoints], None]) -> None:
        self._limits = limits
        self._send = send
        lowest = np.ceil(np.degrees(limits.lower) / _STEP - _ROUNDING) * _STEP
        highest = np.floor(np.degrees(limits.upper) / _STEP + _ROUNDING) * _STEP
        self.ranges: list[tuple[float, float]] = list(
            zip(lowest.tolist(), highest.tolist(), strict=True)
        )
        self.target: Array | None = None
        self._unsent = False
        self._sent_at = -math.inf
        self._dragged_at = -math.inf

    def drag(self, arm: JointSample, joint: int, angle: float) -> None:
        """Take an angle of a joint, deg; the others go on to where they were sent, or stay.

        A joint that rests where it was sent stays sent there: friction holds it a little beside.
        """
        target = (arm.position if self.target is None else self.target).copy()
        target[joint] = np.radians(angle)
        self.target = target
        self._unsent = True
        self._dragged_at = time.monotonic()

    def follow(self, arm: JointSample, now: float) -> list[float] | None:
        """Send what was dragged; return what sliders show, deg, None while somebody drags one."""
        if self.target is not None and self._unsent and now >= self._sent_at + _INTERVAL:
            self._unsent = False
            self._sent_at = now
            self._send(jog(arm.position, arm.velocity, self.target, self._limits))
        if now < self._dragged_at + _SETTLED:
            return None
        rests = np.abs(arm.velocity).max() < _AT_REST
        if (
            self.target is not None
            and rests
            and np.abs(arm.position - self.target).max() > _ARRIVED
        ):
            self.target = None  # it was refused, or others have moved the arm
        shown = np.degrees(arm.position if self.target is None else self.target)
        ends = zip(shown.tolist(), self.ranges, strict=True)
        return [min(max(round(angle, 1), low), high) for angle, (low, high) in ends]


def _within(low: float, high: float, angle: object) -> bool:
    return isinstance(angle, float | int) and low <= angle <= high
