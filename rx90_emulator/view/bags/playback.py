"""Time that runs while a recording is played; no clock is read here."""

from __future__ import annotations

from dataclasses import dataclass

SLOWEST, FASTEST = 0.01, 10.0


@dataclass
class Playback:
    """A time between the beginning and the end of what is played.

    Attributes:
        end: s; the beginning is 0.
        time: s.
        speed: recorded seconds for each second of the wall clock.
        playing: whether time runs.
        loop: whether it begins again at its end.
    """

    end: float
    time: float = 0.0
    speed: float = 1.0
    playing: bool = False
    loop: bool = False

    def seek(self, time: float) -> None:
        """Go to a time; before the beginning or after the end to these."""
        self.time = min(max(time, 0.0), self.end)

    def play(self) -> None:
        """Let time run; from the beginning, where it is at the end."""
        if self.time >= self.end:
            self.time = 0.0
        self.playing = True

    def advance(self, elapsed: float) -> None:
        """Let `elapsed` s of the wall clock go by; at the end time stops, or begins again."""
        if not self.playing:
            return
        time = self.time + self.speed * elapsed
        if time < self.end:
            self.time = time
        elif self.loop and self.end > 0.0:
            self.time = time % self.end
        else:
            self.time, self.playing = self.end, False
