"""The names of the solutions of the inverse kinematics."""

from __future__ import annotations

from dataclasses import dataclass

SHOULDERS = ("front", "back")
SIGNS = ("positive", "negative")


@dataclass(frozen=True)
class Branch:
    """Which of the eight solutions of a spherical-wrist arm.

    Attributes:
        shoulder: 'front': the wrist centre is on the side of axis 1 that the arm plane faces at q = 0.
        elbow: sign of the angle from the upper arm to the forearm (of q3 on the RX90).
        wrist: sign of q5.
    """

    shoulder: str = "front"
    elbow: str = "positive"
    wrist: str = "positive"

    def __post_init__(self) -> None:
        if self.shoulder not in SHOULDERS or self.elbow not in SIGNS or self.wrist not in SIGNS:
            raise ValueError(f"{self} is not a branch; accepted: {SHOULDERS}, {SIGNS}, {SIGNS}")

    def __str__(self) -> str:
        return f"{self.shoulder}/{self.elbow}/{self.wrist}"
