"""The controls with which a recording is played: all of them by mouse or touch, no key is needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import viser

from rx90_common.base.rates import NANOSECONDS
from rx90_emulator.view.bags.playback import Playback
from rx90_emulator.view.page import Page

_SPEEDS = ("0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1", "2", "5", "10")
_STEP = 1e-3  # s, of the slider
_HOLDS_STILL = 0.4  # s after the slider was moved by hand, in which it is not moved by the page
_MOST_MARKS = 12


class PlayControls:
    """Slider, buttons and choices for a playback.

    Args:
        page: to draw in, within a `tab`.
        playback: that they control.
        marks: times, s, that stand below the slider.
    """

    def __init__(self, page: Page, playback: Playback, marks: Sequence[float]) -> None:
        gui = page.gui
        self._playback = playback
        self._moved_at = -1.0
        self._now = 0.0
        self._slider = gui.add_slider(
            "time, s", 0.0, max(playback.end, _STEP), _STEP, initial_value=0.0,
            marks=tuple(marks[:_MOST_MARKS]) or None,
        )  # fmt: skip
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self._speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1", hint="recorded seconds in each second")
        self._loop = gui.add_checkbox("loop", initial_value=False, hint="begin again at the end")
        self._slider.on_update(_by_hand(page, self._scrub))
        self._play.on_click(lambda _: page.later(self._toggle))
        self._speed.on_update(_by_hand(page, self._take_choices))
        self._loop.on_update(_by_hand(page, self._take_choices))

    def go_to(self, time: float) -> None:
        """Show a time, s, and stay there."""
        self._playback.playing = False
        self._playback.seek(time)
        self._set(self._playback.time)

    def follow(self, now: float) -> None:
        """Show what the playback does; `now` is the steady clock's time, s."""
        self._now = now
        if now - self._moved_at > _HOLDS_STILL:
            self._set(self._playback.time)
        label = "Pause" if self._playback.playing else "Play"
        if self._play.label != label:
            self._play.label = label
            self._play.icon = viser.Icon.PLAYER_PAUSE if self._playback.playing else viser.Icon.PLAYER_PLAY

    def _set(self, time: float) -> None:
        # mypy does not find the setter, which viser defines apart from its property.
        self._slider.value = round(time / _STEP) * _STEP  # type: ignore[misc]

    def _scrub(self) -> None:
        self._moved_at = self._now
        self._playback.seek(self._slider.value)

    def _toggle(self) -> None:
        if self._playback.playing:
            self._playback.playing = False
        else:
            self._playback.play()

    def _take_choices(self) -> None:
        self._playback.speed = float(self._speed.value)
        self._playback.loop = bool(self._loop.value)


def _by_hand(page: Page, function: Callable[[], None]) -> Callable[[viser.GuiEvent[Any]], None]:
    """Return a callback that has `function` called for changes made on a page, not for those of this program."""

    def changed(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            page.later(function)

    return changed


def relative(time_ns: int, origin_ns: int) -> float:
    """Return a stamp as the time that the page shows, s."""
    return (time_ns - origin_ns) / NANOSECONDS
