"""A slider for each joint: it moves the joint, and follows it when something else does."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.lines.approach import Approach
from rx90_controller.trajectory import JointLimits, TrajectoryPoints
from rx90_emulator.view.changes import on_change, put
from rx90_emulator.view.page import Page
from rx90_emulator.view.panel.jogging import JogTarget, jog, slider_range
from rx90_emulator.view.panel.newest import NewestOnly
from rx90_emulator.view.state import ArmState

_STEP = 0.1  # deg
_INTERVAL = 0.2  # s from one trajectory to the next while a slider is dragged
_ON_ITS_WAY = 2.0  # s; the longest that what the page shows takes to a browser
_SETTLED = 0.5  # s after the last change by a user, who may type on before


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
