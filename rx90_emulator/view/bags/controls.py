"""The controls with which a recording is played: all of them by mouse or touch, no key is needed."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic

import viser

from rx90_emulator.view.bags.playback import Playback
from rx90_emulator.view.changes import from_user, on_change, put
from rx90_emulator.view.page import Page

_SPEEDS = ("0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1", "2", "5", "10")
_STEP, _DIGITS = 1e-3, 3  # s, of the slider
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
        self._moved_at = 0.0
        self._set_to = 0.0
        self._slider = gui.add_slider(
            "time, s", 0.0, max(playback.end, _STEP), _STEP, initial_value=0.0,
            marks=tuple(marks[:_MOST_MARKS]) or None,
        )  # fmt: skip
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self._speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1", hint="recorded seconds in each second")
        self._loop = gui.add_checkbox("loop", initial_value=False, hint="begin again at the end")
        on_change(self._slider, self._scrubbed, page)
        self._play.on_click(from_user(self._toggle, page))

    def go_to(self, time: float) -> None:
        """Show a time, s, and stay there."""
        self._playback.playing = False
        self._playback.seek(time)
        self._set(self._playback.time)

    def follow(self, now: float) -> None:
        """Take what was chosen on the page, and show what the playback does; `now` is the steady clock's time, s."""
        self._playback.speed = float(self._speed.value)
        self._playback.loop = bool(self._loop.value)
        # Another value than was set is one that a user has just chosen, and is taken first.
        if self._slider.value == self._set_to and now - self._moved_at > _HOLDS_STILL:
            self._set(self._playback.time)
        label = "Pause" if self._playback.playing else "Play"
        if self._play.label != label:
            self._play.label = label
            self._play.icon = viser.Icon.PLAYER_PAUSE if self._playback.playing else viser.Icon.PLAYER_PLAY

    def _set(self, time: float) -> None:
        self._set_to = round(time, _DIGITS)
        put(self._slider, self._set_to)

    def _scrubbed(self) -> None:
        self._set_to, self._moved_at = self._slider.value, monotonic()
        self._playback.seek(self._set_to)

    def _toggle(self) -> None:
        if self._playback.playing:
            self._playback.playing = False
        else:
            self._playback.play()
