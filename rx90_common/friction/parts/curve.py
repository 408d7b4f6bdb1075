"""Curve: the sliding torque c0 g(v) is that of a table, for each sign of the velocity, in place of equation 19.

Between its points the torque is a monotone cubic: Hermite's, with the slopes of Fritsch and Butland (1984, A method for
constructing local monotone piecewise cubic interpolants, SIAM J. Sci. Stat. Comput. 5(2)) and one-sided parabolas at
both ends, as MATLAB's and SciPy's pchip have it. Slower than the first point and faster than the last one it is a
straight line with the slope at that point. The torque is positive at every speed: it may not fall at the last point,
and the line before the first one must end above 0 at rest.

The viscous part c2 comes on top; it is 0 for a table that has it in its torques. So does the load's friction, by the
element's own omega_s and delta; ripple and scatter multiply the torque of the table, temperature changes c2 alone.
tau_c and tau_s do not count while the curve is on, neither for break-away, which is that of the table.

The storage c0 z^2 / 2 does not depend on g: the element is passive where c1 |v| < 4 c0 g(v), as with equation 19.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from rx90_common.base.arrays import Array, RecordType, record_type
from rx90_common.base.models import FileModel, Positive, quantity, refusal
from rx90_common.friction.parts.part import FrictionPart, Moment, Part, Present, Surroundings
from rx90_common.friction.signs import BySign
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import lane, load, select

MAX_POINTS = 64
"""Of the table of one sign."""

_list = Field(strict=False, min_length=2, max_length=MAX_POINTS)
_Speeds: TypeAlias = Annotated[tuple[Annotated[float, Field(ge=0.0, le=1e6)], ...], _list]
_Torques: TypeAlias = Annotated[tuple[Positive, ...], _list]


class Cubics(NamedTuple):
    """A piecewise cubic, polynomials of the speed beyond the start of each piece.

    Attributes:
        start: of the pieces, rad/s, from rest on, shape (p,).
        coefficients: from the constant on, shape (4, p).
    """

    start: Array
    coefficients: Array


class CurveTable(FileModel):
    """Sliding torque by speed, in place of tau_c and tau_s, or such a block for each of positive and negative."""

    velocity: Annotated[_Speeds, quantity("rad/s", "Speeds, each above the one before.")]
    torque: Annotated[
        _Torques, quantity("Nm", "Steady sliding torque at each of them, without c2's.")
    ]

    @model_validator(mode="after")
    def _check_points(self) -> CurveTable:
        if any(before >= after for before, after in pairwise(self.velocity)):
            raise refusal("velocity", self.velocity, "numbers each above the one before")
        if len(self.torque) != len(self.velocity):
            raise refusal(
                "torque", self.torque, f"{len(self.velocity)} numbers, as many as velocity has"
            )
        slopes = self.slopes
        if slopes[-1] < 0.0:
            raise refusal(
                "torque",
                self.torque,
                "numbers that do not fall at the end, or friction would end at speed",
            )
        if self.torque[0] <= slopes[0] * self.velocity[0]:
            raise refusal(
                "torque",
                self.torque,
                "numbers whose line before the first point is above 0 at rest",
            )
        return self

    @property
    def slopes(self) -> list[float]:
        """Return the slopes at the points, Nm s/rad."""
        widths = np.diff(self.velocity).tolist()
        secants = (np.diff(self.torque) / widths).tolist()
        if len(secants) == 1:
            return [*secants, *secants]
        inner = [
            _inner_slope(*pair, *widths[k : k + 2]) for k, pair in enumerate(pairwise(secants))
        ]
        first = _end_slope(*secants[:2], *widths[:2])
        last = _end_slope(*secants[:-3:-1], *widths[:-3:-1])
        return [first, *inner, last]

    @property
    def steepest(self) -> float:
        """Return the largest slope, Nm s/rad: at a point, or half-way between two."""
        secants = np.diff(self.torque) / np.diff(self.velocity)
        return float(max(*self.slopes, 1.5 * secants.max()))

    @property
    def cubics(self) -> Cubics:
        """Return the pieces: the line from rest on, one between each two points, and the line beyond the last one."""
        velocity = np.array(self.velocity)
        torque = np.array(self.torque)
        slope = np.array(self.slopes)
        width = np.diff(velocity)
        secant = np.diff(torque) / width
        coefficients = np.zeros((4, len(velocity) + 1))
        coefficients[0] = [torque[0] - slope[0] * velocity[0], *torque]
        coefficients[1] = [slope[0], *slope]
        coefficients[2, 1:-1] = (3.0 * secant - 2.0 * slope[:-1] - slope[1:]) / width
        coefficients[3, 1:-1] = (slope[:-1] + slope[1:] - 2.0 * secant) / width**2
        return Cubics(np.concatenate([[0.0], velocity]), coefficients)

    def at(self, speed: Array) -> Array:
        """Return the torque at speeds, rad/s, Nm, of the same shape."""
        start, coefficients = self.cubics
        piece = np.searchsorted(start, speed, side="right") - 1
        c = coefficients[:, piece]
        x = speed - start[piece]
        return np.asarray(((c[3] * x + c[2]) * x + c[1]) * x + c[0])


def _inner_slope(before: float, after: float, width: float, next_width: float) -> float:
    """Return the slope between two secants: a weighted harmonic mean, or 0 at a turn."""
    if before * after <= 0.0:
        return 0.0
    near = 2.0 * next_width + width
    far = next_width + 2.0 * width
    return (near + far) / (near / before + far / after)


def _end_slope(secant: float, following: float, width: float, next_width: float) -> float:
    """Return the slope at an end: the parabola's through three points, if the curve keeps its shape with it."""
    slope = ((2.0 * width + next_width) * secant - width * following) / (width + next_width)
    if slope * secant <= 0.0:
        return 0.0
    if secant * following <= 0.0 and abs(slope) > 3.0 * abs(secant):
        return 3.0 * secant
    return slope


class CurvePart(BySign[CurveTable], FrictionPart):
    """Sliding torque by tables."""

    @property
    def steepest(self) -> float:
        """Return the largest growth of the torque with the speed, Nm s/rad."""
        return max(0.0, *(table.steepest for table in self.both))

    @property
    def at_rest(self) -> BySign[float]:
        """Return the torque at rest, which friction breaks away from, Nm."""
        start = np.zeros(1)
        return BySign[float](
            positive=self.positive.at(start)[0], negative=self.negative.at(start)[0]
        )

    @property
    def ratio(self) -> float:
        """Return how many times the torque of one direction is that of the other at most, at rest and at the points."""
        speed = np.array([0.0, *self.positive.velocity, *self.negative.velocity])
        ratio = self.positive.at(speed) / self.negative.at(speed)
        return float(np.max([ratio, 1.0 / ratio]))

    def sliding_torque(self, velocity: Array, torque: Array) -> Array:  # noqa: ARG002 - replaced
        """Return the torque of the tables, Nm."""
        speed = np.abs(velocity)
        return np.where(velocity >= 0.0, *(table.at(speed) for table in self.both))


def curve_dtype(width: int) -> RecordType:
    """Return the type of the constants: the pieces of each sign; none where the part is off."""
    rows = (2, MAX_POINTS + 1, width)
    return record_type(
        ("pieces", np.int64, (2, width)),
        used=np.int64,  # 1 if any element has a curve
        start=rows,
        coefficients=(4, *rows),
    )


def curve_state_dtype(width: int) -> RecordType:
    """Return the type of the state: sliding torques of the step, workspace, 0 where the part is off."""
    return record_type(torque=width)


def fill_curve(record: Any, e: int, part: CurvePart, _: Surroundings) -> None:
    """Write the constants of element e."""
    record["used"] = 1
    for sign, table in enumerate(part.both):
        start, coefficients = table.cubics
        count = len(start)
        record["pieces"][sign, e] = count
        record["start"][sign, :count, e] = start
        record["coefficients"][:, sign, :count, e] = coefficients


@inlined
def _torque(part: Any, sign: int, element: int, speed: float) -> float:
    """Return the sliding torque of one element, Nm."""
    piece = 0
    end = part.pieces[sign, element]
    while end - piece > 1:
        middle = (piece + end) // 2
        if part.start[sign, middle, element] <= speed:
            piece = middle
        else:
            end = middle
    c = part.coefficients[:, sign, piece, element]
    x = speed - part.start[sign, piece, element]
    return ((c[3] * x + c[2]) * x + c[1]) * x + c[0]  # type: ignore[no-any-return]


@inlined
def curved(parts: Any, state: Any, present: Present, moment: Moment, width: int) -> Present:
    """Put the torques of the tables in place of tau_c and tau_s."""
    if not parts.curve.used:
        return present
    for e in range(width):
        speed = lane(moment.velocity, e)
        sign = 0 if speed >= 0.0 else 1
        if parts.curve.pieces[sign, e] > 0:
            state.curve.torque[e] = _torque(parts.curve, sign, e, abs(speed))
    torque = load(state.curve.torque, width)
    given = torque > 0.0
    return Present(
        (select(given, torque, present.tau_c[0]), select(given, torque, present.tau_c[1])),
        (select(given, torque, present.tau_s[0]), select(given, torque, present.tau_s[1])),
        present.inverse_omega_s,
        present.c2,
        present.scale,
        present.coulomb,
        present.static,
    )


CURVE = Part((CurveTable,), curve_dtype, fill_curve, state=curve_state_dtype, present=curved)
