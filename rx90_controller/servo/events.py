"""What a state of the controller answers between two ticks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from rx90_common.base.arrays import Array, Record
from rx90_common.base.rates import NANOSECONDS
from rx90_controller.law.cs7b import DriveFault
from rx90_controller.trajectory.request import JoinedAhead, TrajectoryRequest
from rx90_controller.trajectory.stream import SetPoints


@dataclass(frozen=True, eq=False)
class Offer:
    """A trajectory of the topic or a goal, checked by itself; perhaps joined to a fork of the motion already."""

    request: TrajectoryRequest
    joined: JoinedAhead | None = None


@dataclass(frozen=True, eq=False)
class Streamed:
    """Set-points of a stream, and the name of their source, in words."""

    points: SetPoints
    source: str


@dataclass(frozen=True, eq=False)
class Cancel:
    """A goal's client takes it back."""

    request: TrajectoryRequest


@dataclass(frozen=True)
class GiveUp:
    """The goal, if there is one, is to end for a reason; with `halt` the arm stops along the path."""

    reason: str
    halt: bool = False


@dataclass(frozen=True)
class TorqueSwitch:
    """The torque is switched on or off; `by_node`: because the node comes into its state active, or leaves it."""

    on: bool
    by_node: bool = False

    @property
    def reason(self) -> str:
        """Return why what is followed ends with the torque."""
        return (
            "the controller is deactivated, the torque is off"
            if self.by_node
            else "the torque is off"
        )


@dataclass(frozen=True, eq=False)
class LawChange:
    """Other constants of the law, shape (1,), and who learns the time, ns, of the tick from which on they count."""

    law: Record
    effective: Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Begin:
    """States that do not follow the last ones: their stamp, ns, and the positions of the motors, rad, shape (n,)."""

    stamp_ns: int
    position: Array

    @property
    def reason(self) -> str:
        """Return why what is followed then ends."""
        return f"the states go on from {self.stamp_ns / NANOSECONDS:.6g} s; holding"


@dataclass(frozen=True, eq=False)
class Fault:
    """The supervision has found a violation, with the motors at positions, rad, shape (n,)."""

    fault: DriveFault
    position: Array


Event: TypeAlias = Offer | Streamed | Cancel | GiveUp | TorqueSwitch | LawChange | Begin | Fault
