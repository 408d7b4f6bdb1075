"""What motions are made with: speeds, accelerations, switches, tool and base."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.branch import Branch

_SWITCHES: Final = {"DURATION": 0.0, "CP": 1.0, "NULL": 1.0, "FINE": 100.0}


@dataclass(frozen=True)
class Speed:
    """A program speed.

    Attributes:
        percent: of the full speeds, of the joints and along lines.
        rotary: percent of the full speed of the tool's turn.
    """

    percent: float = 100.0
    rotary: float = 100.0


@dataclass
class Settings:
    """What motions are made with.

    Attributes:
        speed: of all motions.
        next_speed: of the next one alone; None for that of all.
        switches: DURATION (s), CP, NULL, FINE (percent) and their like, for all motions.
        next_switches: for the next one alone.
        acceleration: of the ramps up and down, percent.
        smooth: whether their acceleration has no jumps.
        scaled: whether the program speed scales accelerations, too.
        tool: from the flange.
        base: where the robot stands.
        wanted: of LEFTY, ABOVE, FLIP and their opposites the newest ones.
        hand_time: s that the hand takes.
        at_start: what the next motion does when it begins.
        dry: whether the arm does not move.
    """

    speed: Speed = field(default_factory=Speed)
    next_speed: Speed | None = None
    switches: dict[str, float] = field(default_factory=lambda: dict(_SWITCHES))
    next_switches: dict[str, float] = field(default_factory=dict)
    acceleration: tuple[float, float] = (100.0, 100.0)
    smooth: bool = False
    scaled: bool = True
    tool: Array = field(default_factory=lambda: np.eye(4))
    base: Array = field(default_factory=lambda: np.eye(4))
    wanted: dict[str, str] = field(default_factory=dict)
    hand_time: float = 0.05
    at_start: list[Callable[[], None]] = field(default_factory=list)
    dry: bool = False

    def reset(self) -> None:
        """Set what EXECUTE sets."""
        self.speed = Speed()
        self.next_speed = None
        self.switches = dict(_SWITCHES)
        self.next_switches = {}

    def posture(self, present: Branch) -> Branch:
        """Return the configuration of the next motion that is no line."""
        shoulder = {"LEFTY": "back", "RIGHTY": "front"}.get(self.wanted.get("shoulder", ""), present.shoulder)
        wrist = {"FLIP": "negative", "NOFLIP": "positive"}.get(self.wanted.get("wrist", ""), present.wrist)
        is_above = (present.elbow == "positive") == (present.shoulder == "front")
        above = {"ABOVE": True, "BELOW": False}.get(self.wanted.get("elbow", ""), is_above)
        elbow = "positive" if above == (shoulder == "front") else "negative"
        return Branch(shoulder, elbow, wrist)

    def take(self) -> tuple[Speed, dict[str, float]]:
        """Return speed and switches of the next motion, which are used up."""
        speed = self.next_speed or self.speed
        switches = {**self.switches, **self.next_switches}
        self.next_speed = None
        self.next_switches = {}
        return speed, switches
