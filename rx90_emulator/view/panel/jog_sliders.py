"""A slider for each joint: it moves the joint, and follows it when something else does."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.lines.approach import Approach
from rx90_controller.trajectory import JointLimits, TrajectoryPoints
from rx90_emulator.view.page import Page
from rx90_emulator.view.panel.jogging import JogTarget, jog, slider_range
from rx90_emulator.view.panel.newest import NewestOnly
from rx90_emulator.view.panel.widgets import from_user, put
from rx90_emulator.view.state import ArmState

_STEP = 0.1  # deg
_INTERVAL = 0.2  # s from one trajectory to the next while a slider is dragged


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
            slider.on_update(from_user(lambda joint=joint: self._dragged(joint), page))  # type: ignore[misc]
            self._sliders.append(slider)
        # What each slider was last seen with: another value is one that a user has just given, and is taken first.
        self._seen = [slider.value for slider in self._sliders]

    def close(self) -> None:
        """End the thread that sends."""
        self._sending.close()

    def follow(self, arm: ArmState | None, *, ready: bool) -> None:
        """Show where the arm is, or where it was sent; without an arm, or a controller that is ready, nothing moves."""
        self._arm = arm
        if arm is not None:
            shown = np.degrees(self._target.shown(arm.position, time.monotonic()))
            for joint, (slider, angle) in enumerate(zip(self._sliders, shown, strict=True)):
                if slider.value == self._seen[joint]:
                    put(slider, min(max(round(float(angle), 1), slider.min), slider.max))
                    self._seen[joint] = slider.value
        for slider in self._sliders:
            if slider.disabled != (arm is None or not ready):
                slider.disabled = not slider.disabled

    def forget(self) -> None:
        """Show the arm again: something else was sent, or the move was refused."""
        self._target.forget()

    def _dragged(self, joint: int) -> None:
        self._seen[joint] = self._sliders[joint].value
        if self._arm is not None:
            angle = float(np.radians(self._seen[joint]))
            now = time.monotonic()
            self._sending.give((self._arm, self._target.drag(joint, angle, self._arm.position, now)))
