"""Curves in space as functions of their length: lines, arcs, cubic splines and blends, one after the other.

A spline and a blend are polynomials of a parameter that is not their length. Their length is integrated by Gauss and
Legendre's formula over short cells, and inverted by Newton's steps, to rounding.

A blend is a polynomial of the fifth degree that has place, tangent and curvature of its neighbours at both ends: the
acceleration of what travels it does not jump.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import LineError
from rx90_common.description.kinematics import PathError, decompose, nearest_corner
from rx90_common.description.rotations import length
from rx90_controller.trajectory.spline import interpolate

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline, PPoly

_CELLS = 16  # of a polynomial's length, in each of its intervals
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_NEWTON = 5
_COLLINEAR = 1e-9  # sine between the chords of three points
_ROUNDED = 2e-5  # m: by how much ends of an arc may be unequally far from its centre, as drawings print them
_SHARPEST = -0.98  # cosine of the turn at a corner that a blend rounds
KINK = 1e-3
"""A corner up to this angle, rad, is travelled without a stop, by set-points one period apart."""


class Piece(Protocol):
    """A curve by its length, m."""

    @property
    def length(self) -> float: ...  # noqa: D102

    def at(self, distance: Array, order: int) -> Array:
        """Return the derivative of an order, 0 to 3, by the distance (n,) m from the start; shape (n, 3)."""


@dataclass(frozen=True, eq=False)
class Straight:
    """A straight line from `start`, (3,) m, along a unit vector."""

    start: Array
    direction: Array
    length: float

    def at(self, distance: Array, order: int) -> Array:
        """Return a derivative."""
        if order == 0:
            return self.start + distance[:, None] * self.direction
        return np.broadcast_to(self.direction if order == 1 else np.zeros(3), (len(distance), 3))


@dataclass(frozen=True, eq=False)
class Circular:
    """An arc: from `center` the start lies in the direction of `outward`, and the motion begins in that of `onward`."""

    center: Array
    outward: Array
    onward: Array
    radius: float
    length: float

    def at(self, distance: Array, order: int) -> Array:
        """Return a derivative."""
        angle = distance / self.radius + 0.5 * math.pi * order
        radial = np.cos(angle)[:, None] * self.outward + np.sin(angle)[:, None] * self.onward
        return self.radius ** (1 - order) * radial + (self.center if order == 0 else 0.0)


class Polynomial:
    """A piecewise polynomial of a parameter, travelled by its length.

    Args:
        curve: the place (3,), m.
    """

    def __init__(self, curve: PPoly) -> None:
        self._orders = [curve.derivative(k) if k else curve for k in range(4)]
        knots = curve.x
        self._cells = np.append(
            np.linspace(knots[:-1], knots[1:], _CELLS, endpoint=False).T.ravel(), knots[-1]
        )
        self._lengths = np.concatenate(
            [[0.0], np.cumsum(self._way(self._cells[:-1], self._cells[1:]))]
        )
        self.length = float(self._lengths[-1])
        self.knots: Array = self._lengths[::_CELLS]

    def _way(self, first: Array, last: Array) -> Array:
        """Return the lengths from parameters to others of the same cells, (n,)."""
        half = 0.5 * (last - first)
        at = (first + half)[:, None] + half[:, None] * _NODES
        return half * (length(self._orders[1](at)) @ _WEIGHTS)

    def _parameter(self, distance: Array) -> Array:
        cell = np.clip(
            np.searchsorted(self._lengths, distance, side="right") - 1, 0, len(self._cells) - 2
        )
        first = self._cells[cell]
        last = self._cells[cell + 1]
        way = distance - self._lengths[cell]
        whole = self._lengths[cell + 1] - self._lengths[cell]
        u = first + (last - first) * way / whole
        for _ in range(_NEWTON):
            u = np.clip(u - (self._way(first, u) - way) / length(self._orders[1](u)), first, last)
        return np.asarray(u)

    def at(self, distance: Array, order: int) -> Array:
        """Return a derivative, by the chain rule."""
        u = self._parameter(distance)
        if order == 0:
            return self._orders[0](u)
        first = self._orders[1](u)
        speed = length(first)[:, None]
        tangent = first / speed
        if order == 1:
            return tangent
        second = self._orders[2](u)
        growth = np.sum(tangent * second, axis=1)[:, None]  # of the speed, by the parameter
        normal = second - growth * tangent
        if order == 2:
            return np.asarray(normal / speed**2)
        third = self._orders[3](u)
        turn = normal / speed
        change = (
            third
            - growth * turn
            - np.sum(turn * second + tangent * third, axis=1)[:, None] * tangent
        )
        return np.asarray((change - 2.0 * growth * normal / speed) / speed**3)


@dataclass(frozen=True, eq=False)
class _Part:
    """A piece without the parts at its ends that blends replace."""

    of: Piece
    begin: float
    length: float

    def at(self, distance: Array, order: int) -> Array:
        return self.of.at(distance + self.begin, order)


def line(start: Array, end: Array) -> Straight:
    """Return a line between two points, (3,) m.

    Raises:
        LineError: for equal points.
    """
    way = end - start
    whole = float(length(way))
    if whole == 0.0:
        raise LineError(f"starts and ends at {_point(start)} m; accepted: two different points")
    return Straight(start, way / whole, whole)


def arc_through(start: Array, via: Array, end: Array) -> Circular:
    """Return the arc through three points, (3,) m, in their order.

    Raises:
        LineError: for points on one line.
    """
    a = via - start
    b = end - start
    normal = np.cross(a, b)
    scale = float(length(a) * length(b) * max(1e-300, float(length(end - via))))
    if float(length(normal)) * float(length(end - via)) <= _COLLINEAR * scale:
        raise LineError(
            f"an arc through {_point(start)}, {_point(via)} and {_point(end)} m, which lie on one line; accepted: "
            "three points of a circle (a full one: its centre, and its start as its end)"
        )
    to_center = np.cross((a @ a) * b - (b @ b) * a, normal) / (2.0 * (normal @ normal))
    return _arc(start, start + to_center, end, normal / length(normal))


def arc_about(start: Array, center: Array, end: Array, normal: Array) -> Circular:
    """Return the arc about a centre, counter-clockwise seen from where its normal points to.

    It is a full circle where it ends at its start. The points are (3,) m; a centre whose distances to the ends differ
    by rounding is moved to the middle between them.

    Raises:
        LineError: for ends unequally far from the centre, or out of the plane.
    """
    size = float(length(normal))
    if size == 0.0:
        raise LineError("an arc whose normal is 0; accepted: a direction")
    normal = normal / size
    near = float(length(start - center))
    far = float(length(end - center))
    if near == 0.0 or abs(near - far) > _ROUNDED:
        raise LineError(
            f"an arc about {_point(center)} m: its ends are {near:.6g} and {far:.6g} m from there; accepted: equally "
            f"far, within {_ROUNDED:g} m"
        )
    for what, place in (("start", start), ("end", end)):
        off = float((place - center) @ normal)
        if abs(off) > _ROUNDED:
            raise LineError(
                f"an arc whose {what} is {off:.6g} m out of its plane; accepted: within {_ROUNDED:g} m"
            )
    center = center + ((start - center) @ normal) * normal
    chord = end - start
    if np.any(chord):
        normal = normal - (normal @ chord) / (chord @ chord) * chord
        normal = normal / length(normal)
        center = center + ((start + end) / 2.0 - center) @ chord / (chord @ chord) * chord
    return _arc(start, center, end, normal)


def _arc(start: Array, center: Array, end: Array, normal: Array) -> Circular:
    radius = float(length(start - center))
    outward = (start - center) / radius
    onward = np.cross(normal, outward)
    angle = math.atan2(float((end - center) @ onward), float((end - center) @ outward)) % (
        2.0 * math.pi
    )
    if not np.any(end - start):
        angle = 2.0 * math.pi
    return Circular(center, outward, onward, radius, radius * angle)


def spline(points: Array, corner: bool = False) -> Polynomial:
    """Return the curve of `spline_through` by its length."""
    return Polynomial(spline_through(points, corner))


def spline_through(points: Array, corner: bool) -> CubicSpline:
    """Return the natural cubic spline through points (n, 3) m, over its chords.

    Args:
        points: if the last is the first one, the spline is closed.
        corner: whether it has a corner there, and so is not.

    Raises:
        LineError: for equal points next to each other.
    """
    chords = length(np.diff(points, axis=0))
    if not chords.all():
        raise LineError(
            f"a spline with the point {_point(points[int(np.argmin(chords))])} m twice; accepted: once"
        )
    from scipy.interpolate import CubicSpline  # takes a while

    closed = len(points) > 3 and not corner and not np.any(points[-1] - points[0])
    over = np.append(0.0, np.cumsum(chords))
    return CubicSpline(over, points, bc_type="periodic" if closed else "natural")


def _blend(before: Piece, after: Piece, zone: float) -> Polynomial:
    """Return the polynomial from the last `zone` m of a piece to the first ones of the next."""
    from scipy.interpolate import PPoly

    ends = (before, np.array([before.length - zone])), (after, np.array([zone]))
    reach = 2.0 * zone
    derivatives = [
        [reach**order * piece.at(at, order)[0] for piece, at in ends] for order in range(3)
    ]
    quintic = interpolate(np.array([0.0, 1.0]), *map(np.array, derivatives))
    return Polynomial(PPoly(quintic.coefficients.swapaxes(0, 1)[::-1], quintic.times))


class Curve:
    """Pieces one after the other, by the distance from the start.

    Args:
        pieces: each begins where the one before it ends.
        zones: m before and behind each joint that a blend takes the place of; 0 for none. One for each joint.

    Attributes:
        length: m.
        joints: where each piece began, and where the last one ends, before blends: in a blend its middle; m.
        starts: distances at which the pieces begin that are travelled, blends among them, m.

    Raises:
        LineError: for a zone that is longer than half of a neighbour, or one about a turn back.
    """

    def __init__(self, pieces: list[Piece], zones: list[float]) -> None:
        self._pieces: list[Piece] = []
        joints = [0.0]
        at = 0.0
        blended = 0.0
        for i, piece in enumerate(pieces):
            zone = zones[i] if i < len(zones) else 0.0
            if zone > 0.0:
                self._check_zone(i, piece, pieces[i + 1], zone)
            straight = piece.length - blended - zone
            if straight > 1e-9:
                self._pieces.append(
                    piece if straight == piece.length else _Part(piece, blended, straight)
                )
                at += straight
            if zone > 0.0:
                blend = _blend(piece, pieces[i + 1], zone)
                self._pieces.append(blend)
                joints.append(at + 0.5 * blend.length)
                at += blend.length
            else:
                joints.append(at)
            blended = zone
        self.joints = np.array(joints)
        self.starts = np.append(0.0, np.cumsum([piece.length for piece in self._pieces]))
        self.length = float(self.starts[-1])
        self.joints[-1] = self.length

    @staticmethod
    def _check_zone(i: int, piece: Piece, after: Piece, zone: float) -> None:
        most = 0.5 * min(piece.length, after.length)
        if zone > most * (1.0 + 1e-9):
            raise LineError(
                f"segment {i}: zone is {zone:g} m; accepted: up to {most:.6g} m, half of its neighbours"
            )
        turn = float(piece.at(np.array([piece.length]), 1)[0] @ after.at(np.zeros(1), 1)[0])
        if turn < _SHARPEST:
            raise LineError(
                f"segment {i}: zone at a turn by {math.degrees(math.acos(max(turn, -1.0))):.0f} deg; accepted: no zone "
                "there (the tool stops)"
            )

    def at(self, distance: Array, order: int = 0) -> Array:
        """Return the derivative of an order, 0 to 3, by the distance (n,) m, of the next piece at a joint; (n, 3)."""
        distance = np.clip(np.asarray(distance, dtype=np.float64), 0.0, self.length)
        which = np.clip(
            np.searchsorted(self.starts, distance, side="right") - 1, 0, len(self._pieces) - 1
        )
        found = np.empty((len(distance), 3))
        for k in np.unique(which):
            rows = which == k
            found[rows] = self._pieces[k].at(distance[rows] - self.starts[k], order)
        return found

    @cached_property
    def corners(self) -> Mask:
        """Return whether the direction jumps where one piece follows another, (m - 1,)."""
        return 2.0 * np.arcsin(np.minimum(0.5 * self.jumps(1), 1.0)) > KINK

    def jumps(self, order: int) -> Array:
        """Return by how much a derivative jumps where one piece follows another, (m - 1,)."""
        ends = [np.array([piece.length]) for piece in self._pieces[:-1]]
        before = [
            piece.at(end, order)[0] for piece, end in zip(self._pieces[:-1], ends, strict=True)
        ]
        after = [piece.at(np.zeros(1), order)[0] for piece in self._pieces[1:]]
        return length(np.subtract(after, before).reshape(-1, 3))

    @property
    def knots(self) -> Array:
        """Return the distances within pieces at which their third derivative jumps, m."""
        found = [start + piece.knots for start, piece in zip(self.starts, self._pieces, strict=False)
                 if isinstance(piece, Polynomial)]  # fmt: skip
        return np.concatenate([np.empty(0), *found])

    @cached_property
    def _samples(self) -> tuple[Array, Array]:
        """Return distances, the pieces' ends among them, and places; neighbours lie on one piece."""
        step = min(1e-3, self.length / 200.0)
        inner = [np.linspace(a, b, max(2, math.ceil((b - a) / step)) + 1)[:-1]
                 for a, b in zip(self.starts[:-1], self.starts[1:], strict=True)]  # fmt: skip
        distance = np.append(np.concatenate(inner), self.length)
        return distance, self.at(distance)

    def error(self, points: Array, near: Array | None = None) -> PathError:
        """Return the distance of points (n, 3) m from the curve; beyond its ends it continues along its tangents.

        Args:
            points: m.
            near: distances (n,) m along the curve, near which the nearest place is searched: a path may cross itself.
        """
        points = np.asarray(points, dtype=np.float64)
        distance, places = self._samples
        hint = None if near is None else np.searchsorted(distance, np.clip(near, 0.0, self.length))
        nearest = nearest_corner(points, places, hint)
        along = np.full(len(points), np.nan)
        across = np.full(len(points), np.inf)
        for cell in (np.maximum(nearest - 1, 0), np.minimum(nearest, len(distance) - 2)):
            at = self._in_cell(points, distance[cell], distance[cell + 1])
            distances = length(self.at(at) - points)
            along = np.where(distances < across, at, along)
            across = np.minimum(distances, across)
        for end, sign, last in ((0.0, -1.0, 0), (self.length, 1.0, len(distance) - 1)):
            tangent = self.at(np.array([min(end, self.length - 1e-12)]), 1)[0]
            past, lateral = decompose(points - places[last], tangent)
            rows: Mask = (nearest == last) & (sign * past > 0.0)
            along[rows] = (end + past)[rows]
            across[rows] = length(lateral)[rows]
        return PathError(along, across)

    def _in_cell(self, points: Array, low: Array, high: Array) -> Array:
        """Return the nearest distances between two distances of one piece, by Newton's steps."""
        at = 0.5 * (low + high)
        inside = high - 1e-12  # at its end the next piece begins
        for _ in range(_NEWTON):
            off = self.at(at) - points
            tangent = self.at(at, 1)
            bend = self.at(at, 2)
            slope = 1.0 + np.sum(off * bend, axis=1)
            at = np.clip(
                at - np.sum(off * tangent, axis=1) / np.where(slope > 0.1, slope, 1.0), low, inside
            )
        return at


def _point(place: Array) -> str:
    return "(" + ", ".join(f"{x:g}" for x in place) + ")"
