"""A slider for each joint: it moves the joint, and follows it when something else does."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.lines.plan import Approach
from rx90_controller.trajectory import JointLimits, TrajectoryPoints
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.view.changes import on_change, put
from rx90_emulator.view.page import Page
from rx90_emulator.view.panel.newest import NewestOnly
from rx90_emulator.view.state import ArmState

_STEP = 0.1  # deg
_INTERVAL = 0.2  # s from one trajectory to the next while a slider is dragged
_ON_ITS_WAY = 2.0  # s; the longest that what the page shows takes to a browser
_SETTLED = 0.5  # s after the last change by a user, who may type on before
ARRIVED = 2e-3
"""How near to where it was sent the arm counts as there, rad."""
_PATIENCE = 2.0  # s without a motion until a slider shows the arm again, instead of where it was sent
_MOVED = 1e-6  # rad
_ROUNDING = 1e-6  # steps: a limit of whole degrees is one of the ends
_SHORTEST, _LONGER = 0.02, 1.15  # s; from one try to the next
_SAMPLES = np.linspace(0.0, 1.0, 33)[:-1]  # the last one would be the rest behind the end


def jog(position: Array, velocity: Array, target: Array, limits: JointLimits, gentle: Approach) -> TrajectoryPoints:
    """Return a quintic move to rest at a target, as short as speed and acceleration allow.

    It begins with whatever set-point the controller then has, of which the arm's own state is a good guess: the room
    between `gentle` and the controller's limits is for what is left.

    Args:
        position: of the arm, rad, shape (6,).
        velocity: rad/s, shape (6,).
        target: rad, shape (6,).
        limits: the controller's.
        gentle: share of their speeds, and acceleration.
    """
    # Slower than it is, it cannot be at once.
    top = np.maximum(gentle.speed * limits.velocity, np.abs(velocity))
    most = np.minimum(gentle.acceleration, limits.acceleration)
    rest = np.zeros((1, 6))
    positions, velocities = np.stack([position, target]), np.vstack([velocity, rest])
    duration = _SHORTEST
    while _exceeds(duration, positions, velocities, top, most):
        duration *= _LONGER
    return TrajectoryPoints(np.array([round(duration, 3)]), target[None], rest, rest)


def _exceeds(duration: float, positions: Array, velocities: Array, top: Array, most: Array) -> bool:
    """Return whether a quintic between two positions and velocities, shape (2, 6) each, is too fast anywhere."""
    times = np.array([0.0, duration])
    sampled = np.abs(interpolate(times, positions, velocities, np.zeros((2, 6))).sample(_SAMPLES * duration))
    return bool((sampled[:, 1] > top * (1.0 + _ROUNDING)).any() or (sampled[:, 2] > most).any())


class JogTarget:
    """Where the joints are to go, and what their sliders show: that, while the arm is on its way, else the arm."""

    def __init__(self) -> None:
        self._target: Array | None = None
        self._reached: Array | None = None
        self._seen: Array | None = None
        self._moved_at = 0.0

    def drag(self, joint: int, angle: float, arm: Array, now: float) -> Array:
        """Return where all joints are to go when one is sent to an angle, rad; the others go on to where they were.

        A joint that rests where it was sent stays sent there: friction holds it a little beside, and to send it to
        where it is would move it a little with each jog of another joint.

        Args:
            joint: its index.
            angle: rad.
            arm: where the arm is, rad, shape (6,).
            now: time on any clock that does not go back, s.
        """
        begun = self._target if self._target is not None else self._reached
        target = (arm if begun is None else begun).copy()
        target[joint] = angle
        self._target, self._moved_at = target, now
        return target

    def forget(self) -> None:
        """Show the arm again: something else moves it, or the move was refused."""
        self._target = self._reached = None

    def shown(self, arm: Array, now: float) -> Array:
        """Return what the sliders show, rad, shape (6,)."""
        if self._seen is None or np.abs(arm - self._seen).max() > _MOVED:
            self._seen, self._moved_at = arm.copy(), max(now, self._moved_at)
        if self._target is not None and _is_at(arm, self._target):
            self._reached, self._target = self._target, None
        elif now - self._moved_at > _PATIENCE:
            self._target = None
        if self._reached is not None and not _is_at(arm, self._reached):
            self._reached = None  # something else has moved it
        return arm if self._target is None else self._target


def _is_at(arm: Array, target: Array) -> bool:
    return bool(np.abs(arm - target).max() < ARRIVED)


def slider_range(limits: JointLimits, joint: int, step: float) -> tuple[float, float]:
    """Return the ends of a joint's slider, deg: within its limits, and on its steps."""
    low, high = np.degrees([limits.lower[joint], limits.upper[joint]])
    ends = np.ceil(low / step - _ROUNDING) * step, np.floor(high / step + _ROUNDING) * step
    return float(ends[0]), float(ends[1])


class JogSliders:
    """Six sliders in degrees, within the joint limits.

    Args:
        page: to build in, within a tab.
        limits: the controller's.
        send: has a trajectory followed from now on.
    """

    def __init__(self, page: Page, limits: JointLimits, send: Callable[[TrajectoryPoints], None]) -> None:
        self._limits, self._gentle = limits, Approach()
        self._arm: ArmState | None = None
        self._target = JogTarget()
        self._sending: NewestOnly[tuple[ArmState, Array]] = NewestOnly(
            lambda item: send(jog(item[0].position, item[0].velocity, item[1], limits, self._gentle)), _INTERVAL
        )
        self._sliders = []
        for joint, name in enumerate(limits.names):
            low, high = slider_range(limits, joint, _STEP)
            slider = page.gui.add_slider(f"{name}, deg", low, high, _STEP, min(max(0.0, low), high), disabled=True)
            on_change(slider, partial(self._dragged, joint), page)
            self._sliders.append(slider)
        # What each slider was last seen with: another value is one that a user has just given, and is taken first.
        self._seen = [slider.value for slider in self._sliders]
        self._put_at = [-math.inf] * len(self._sliders)  # when each was last moved by the page
        self._given_at = 0.0  # when one was last moved by a user
        self._unsure: set[int] = set()  # sliders that a user has moved while another value was on its way to the page

    def close(self) -> None:
        """End the thread that sends."""
        self._sending.close()

    def follow(self, arm: ArmState | None, *, ready: bool) -> None:
        """Show where the arm is, or where it was sent; without an arm, or a controller that is ready, nothing moves."""
        self._arm = arm
        if arm is not None:
            now = time.monotonic()
            for joint, angle in enumerate(np.degrees(self._target.shown(arm.position, now))):
                self._show(joint, float(angle), now)
        for slider in self._sliders:
            if slider.disabled != (arm is None or not ready):
                slider.disabled = not slider.disabled

    def forget(self) -> None:
        """Show the arm again: something else was sent, or the move was refused."""
        self._target.forget()

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
        if now < self._put_at[joint] + _ON_ITS_WAY:
            self._unsure.add(joint)
        if self._arm is not None:
            angle = float(np.radians(self._seen[joint]))
            self._sending.give((self._arm, self._target.drag(joint, angle, self._arm.position, now)))
