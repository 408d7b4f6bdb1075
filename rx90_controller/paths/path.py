"""The definition of a path, and the speeds at which an arm can travel it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from rx90_common.base.arrays import Array, Index
from rx90_common.base.errors import LineError
from rx90_common.base.quoting import counted
from rx90_common.description.branch import Branch
from rx90_common.description.kinematics import PathError, Pose
from rx90_common.description.rotations import (
    axis_rotation,
    product,
    rotated,
    rpy_rotation,
    transposed,
    turn_between,
)
from rx90_controller.lines.task import (
    DEFAULT_BRANCH,
    LONGEST_LINE,
    LONGEST_MOTION,
    TOOL_DOWN,
    USUAL_ACCELERATION,
    USUAL_SPEED,
    TipTask,
    Vector,
)
from rx90_controller.paths.curve import Curve, Piece, arc_about, arc_through, line, spline
from rx90_controller.paths.profile import LimitedProfile, SpeedLimit

FIXED, TANGENT, INTERPOLATED = ORIENTATIONS = ("fixed", "tangent", "interpolated")
LOWER = "lower"
HOLD = "hold"
SPEED_POLICIES = (LOWER, HOLD)
_FARTHEST = 1e3  # m
_SHORTEST_PATH = 1e-6  # m: far below the arm's resolution; shorter phases vanish in rounding
_TURN = 0.02  # rad of the path between two places at which it is examined
_MAX_PARTS = 50
_JUMP = 1e-3  # rad/m: a smaller change of the tool's turn by the distance is rounding
_BLOCK = 5e-3  # m of the path that have one lowered speed, at least
_BLOCKS = 40  # in a stretch of one speed, at most
# of a joint's limit: the places between those that are looked at need a little more
_SPEED_RESERVE = 0.99
_RESERVE = 0.9  # of a joint's acceleration: quintics round its steps, and overshoot
# of a joint's limit for the path's own acceleration, where it is short of it
_ACCELERATION_SHARE = 0.5


def _check_word(name: str, word: str, accepted: Sequence[str]) -> None:
    if word not in accepted:
        raise LineError(f"{name} is {word!r}; accepted: one of {', '.join(accepted)}")


@dataclass(frozen=True)
class Segment:
    """A part of a path, from the end of the one before it.

    Attributes:
        points: a line: its end; an arc through a point: that point and its end; an arc about a centre: its end; a
            spline: its points behind the start; m.
        kind: "line", "arc" or "spline".
        center: of an arc, m; None for one through a point.
        normal: of the arc's plane; the arc runs counter-clockwise seen from where it points to.
        speed: m/s; None for that of the path.
        zone: m before and behind the end that a blend to the next segment replaces; 0: the tool stops at a corner.
        end_rpy: roll, pitch and yaw of the tool at the end, rad; None: as at its start.
        corner: whether a spline that comes back to its start has a corner there; else it goes over into itself.
    """

    points: tuple[Vector, ...]
    kind: str = "line"
    center: Vector | None = None
    normal: Vector = (0.0, 0.0, 1.0)
    speed: float | None = None
    zone: float = 0.0
    end_rpy: Vector | None = None
    corner: bool = False

    def piece(self, start: Vector) -> Piece:
        """Return the curve from a place, m.

        Raises:
            LineError: if there is none.
        """
        points = np.array([start, *self.points], dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.abs(points).max() <= _FARTHEST:
            raise LineError(
                f"has the points {self.points}; accepted: three numbers for each, up to {_FARTHEST:g} m"
            )
        if self.kind == "line" and len(points) == 2:
            return line(*points)
        if self.kind == "spline":
            return spline(points, self.corner)
        if self.kind == "arc" and self.center is not None and len(points) == 2:
            return arc_about(points[0], np.array(self.center), points[1], np.array(self.normal))
        if self.kind == "arc" and self.center is None and len(points) == 3:
            return arc_through(*points)
        raise LineError(
            f"is of kind {self.kind!r} with {counted(len(self.points), 'point')}; accepted: a line with its end, an "
            "arc with two points or with its centre and its end, a spline with its points"
        )


@dataclass(frozen=True)
class Path(TipTask):
    """A path of the tool centre point in the base frame, a task as `LineTask` is one.

    Attributes:
        start: m.
        segments: one after the other.
        speed: along the path, m/s.
        acceleration: largest one along the path, m/s².
        jerk: largest one along the path, m/s³; infinite: the speed is a trapezoid.
        orientation: "fixed", "tangent" (the tool turns about its own z axis as the path turns about it) or
            "interpolated" (from each segment's orientation to the next, evenly in a path of one segment, else
            beginning and ending gently).
        start_rpy: roll, pitch and yaw of the tool at the start about fixed axes, rad.
        rest_before: s.
        rest_after: s.
        branch: as LineTask's; singularity_margin and start_posture likewise.
        singularity_margin: 1.
        start_posture: rad.
        speed_policy: where a joint's limit asks for less speed: "lower" it, or "hold" it and refuse the path.
        lowered: speeds and accelerations below the required ones, because of the joints' limits; see `within_limits`.
        remarks: the lowered values, in words.

    Raises:
        LineError: naming the segment, the value and what is accepted.
    """

    start: Vector
    segments: tuple[Segment, ...]
    speed: float = USUAL_SPEED
    acceleration: float = USUAL_ACCELERATION
    jerk: float = math.inf
    orientation: str = FIXED
    start_rpy: Vector = TOOL_DOWN
    rest_before: float = 0.5
    rest_after: float = 0.5
    branch: Branch = DEFAULT_BRANCH
    singularity_margin: float = 0.05
    start_posture: Vector | None = None
    speed_policy: str = LOWER
    lowered: tuple[SpeedLimit, ...] = ()
    remarks: tuple[str, ...] = ()

    what: ClassVar[str] = "path"

    def __post_init__(self) -> None:
        if len(self.start_rpy) != 3 or not all(math.isfinite(x) for x in self.start_rpy):
            raise LineError(
                f"the path's start_rpy is {self.start_rpy}; accepted: three finite numbers"
            )
        _check_word("orientation", self.orientation, ORIENTATIONS)
        _check_word("speed_policy", self.speed_policy, SPEED_POLICIES)
        if not self.segments:
            raise LineError("the path has no segments; accepted: one or more")
        values = [("speed", self.speed), ("acceleration", self.acceleration), ("jerk", self.jerk)]
        for i, segment in enumerate(self.segments):
            values += [
                (f"segment {i}: speed", self.speed if segment.speed is None else segment.speed)
            ]
            if not (math.isfinite(segment.zone) and segment.zone >= 0.0):
                raise LineError(f"segment {i}: zone is {segment.zone:g} m; accepted: a number >= 0")
            if segment.end_rpy is not None and self.orientation != INTERPOLATED:
                raise LineError(
                    f"segment {i} turns the tool; accepted: with the orientation {INTERPOLATED}"
                )
        if self.segments[-1].zone > 0.0:
            raise LineError(
                f"segment {len(self.segments) - 1}: zone at the end of the path; accepted: before another"
            )
        for name, value in values:
            if not value > 0.0 or (math.isinf(value) and name != "jerk"):
                raise LineError(f"{name} is {value:g}; accepted: a number > 0")
        self.check_rests()
        if not _SHORTEST_PATH <= self.length <= LONGEST_LINE:
            accepted = f"{_SHORTEST_PATH:g} to {LONGEST_LINE:g} m"
            raise LineError(f"the path's length is {self.length:g} m; accepted: {accepted}")
        if self.orientation == TANGENT:
            self._check_tangent()
        if not self.profile().duration <= LONGEST_MOTION:
            raise LineError(
                f"the path would take {self.profile().duration:g} s; accepted: up to {LONGEST_MOTION:g} s"
            )

    @cached_property
    def curve(self) -> Curve:
        """Return its geometry."""
        pieces: list[Piece] = []
        start = self.start
        for i, segment in enumerate(self.segments):
            try:
                pieces.append(segment.piece(start))
            except LineError as error:
                raise LineError(f"segment {i} ({segment.kind}) {error}") from error
            start = segment.points[-1]
        return Curve(pieces, [segment.zone for segment in self.segments[:-1]])

    @property
    def length(self) -> float:
        """Return its length, m."""
        return self.curve.length

    @cached_property
    def _limits(self) -> tuple[SpeedLimit, ...]:
        joints = self.curve.joints.tolist()
        return tuple(
            SpeedLimit(begin, end, self.speed if segment.speed is None else segment.speed)
            for begin, end, segment in zip(joints[:-1], joints[1:], self.segments, strict=True)
        )

    @cached_property
    def stops(self) -> Vector:
        """Return where the tool stops, m: at the ends, and at corners that no zone rounds."""
        inner = self.curve.starts[1:-1]
        before = self.twists(inner + -1e-09)[0][:, 3:]
        after = self.twists(inner + 0.0)[0][:, 3:]
        jumps = np.abs(after - before).max(axis=1, initial=0.0)
        rates = np.abs(after).max(axis=1, initial=0.0)
        turns = jumps > np.maximum(_JUMP, 1e-3 * rates)
        return (0.0, *inner[self.curve.corners | turns].tolist(), self.length)

    def _check_tangent(self) -> None:
        if self.curve.corners.any():
            at = float(self.curve.starts[1:-1][self.curve.corners][0])
            raise LineError(
                f"the tool turns with the path, which has a corner at {at:.6g} m; accepted: a zone there, or another "
                "orientation"
            )
        grid = np.linspace(0.0, self.length, 400)
        horizontal = np.linalg.norm(
            rotated(transposed(rpy_rotation(self.start_rpy)), self.curve.at(grid, 1))[:, :2], axis=1
        )
        if horizontal.min() < 0.05:
            at = float(grid[int(np.argmin(horizontal))])
            raise LineError(
                f"the tool turns with the path, which runs along the tool's z axis at {at:.6g} m; accepted: a path "
                "across it, or another orientation"
            )

    @cached_property
    def _profile(self) -> LimitedProfile:
        return LimitedProfile(
            (*self._limits, *self.lowered), self.stops, self.acceleration, self.jerk
        )

    def profile(self) -> LimitedProfile:
        """Return the motion along the path."""
        return self._profile

    def corners(self) -> Vector:
        """Return the times of the motion at which an acceleration jumps, s: of the motion, and where the curve does."""
        profile = self.profile()
        curve = self.curve
        places = curve.starts[1:-1]
        if self.orientation == TANGENT:
            places = np.concatenate([places, curve.knots])
        if self.orientation == INTERPOLATED:
            places = np.concatenate([places, curve.joints])
        places = places[(places > 1e-9) & (places < self.length - 1e-9)]
        own = np.array(profile.corners)
        found = profile.times_at(np.unique(places))
        found = found[np.abs(found[:, None] - own).min(axis=1, initial=math.inf) > 1e-6]
        return tuple(np.unique(np.concatenate([own, found])).tolist())

    def places(self, step: float, least: int) -> Array:
        """Return distances at which the path is examined, m: as of a line, and closer where it bends."""
        distance = np.linspace(0.0, self.length, max(least, math.ceil(self.length / step)) + 1)
        turn = np.linalg.norm(self.curve.at(distance, 2), axis=1) * (distance[1] - distance[0])
        # A bend may lie between two of them, with another one that turns back.
        short = np.diff(self.curve.starts) < 2.0 * distance[1]
        low = self.curve.starts[:-1][short]
        high = self.curve.starts[1:][short]
        inside = np.linspace(low, high, 9)[1:-1]
        bend = (
            np.linalg.norm(self.curve.at(inside.ravel(), 2), axis=1)
            .reshape(inside.shape)
            .max(axis=0, initial=0.0)
        )
        begins = np.append(distance[:-1], low)
        ends = np.append(distance[1:], high)
        parts = np.ceil(np.append(np.maximum(turn[1:], turn[:-1]), bend * (high - low)) / _TURN)
        parts = np.minimum(parts.astype(int), _MAX_PARTS)
        inner = [np.linspace(begins[k], ends[k], parts[k] + 1) for k in np.flatnonzero(parts > 1)]
        return np.unique(np.concatenate([distance, *inner]))

    def poses(self, distance: Array) -> Pose:
        """Return the poses of the tool centre point at `distance` (n,) m from the start."""
        distance = np.clip(distance, 0.0, self.length)
        position = self.curve.at(distance)
        first = rpy_rotation(self.start_rpy)
        if self.orientation == FIXED:
            return Pose(position, np.broadcast_to(first, (len(distance), 3, 3)))
        if self.orientation == TANGENT:
            ways = rotated(transposed(first), self.curve.at(np.append(0.0, distance), 1))
            heading = np.arctan2(ways[:, 1], ways[:, 0])
            turn = axis_rotation(np.array([0.0, 0.0, 1.0]), heading[1:] - heading[0])
            return Pose(position, product(first, turn))
        rotation = np.empty((len(distance), 3, 3))
        for rows, rpy, turn, share in self._turns(distance):
            angle = float(np.linalg.norm(turn))
            axis = turn / angle if angle > 0.0 else turn
            rotation[rows] = product(axis_rotation(axis, angle * share[0]), rpy_rotation(rpy))
        return Pose(position, rotation)

    def _turns(
        self, distance: Array
    ) -> list[tuple[Index, Vector, Array, tuple[Array, Array, Array]]]:
        """Return for each segment its rows, orientation at its start, turn, and the completed share of the turn.

        The share comes with its first and second derivative by the distance.
        """
        joints = self.curve.joints
        which = np.clip(
            np.searchsorted(joints, distance, side="right") - 1, 0, len(self.segments) - 1
        )
        found = []
        rpy = self.start_rpy
        for i, segment in enumerate(self.segments):
            end = segment.end_rpy or rpy
            rows = np.flatnonzero(which == i)
            whole = joints[i + 1] - joints[i]
            x = (distance[rows] - joints[i]) / whole
            if len(self.segments) == 1:
                share = x, np.full_like(x, 1.0 / whole), np.zeros_like(x)
            else:  # the polynomial of the fifth degree that begins and ends without speed and acceleration
                share = (
                    x**3 * (10.0 - 15.0 * x + 6.0 * x * x),
                    30.0 * (x * (1.0 - x)) ** 2 / whole,
                    60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / whole**2,
                )
            found.append((rows, rpy, turn_between(rpy, end), share))
            rpy = end
        return found

    def twists(self, distance: Array) -> tuple[Array, Array]:
        """Return first and second derivative of place and orientation by the distance, as of a line, (n, 6)."""
        distance = np.clip(distance, 0.0, self.length)
        first, second = np.zeros((2, len(distance), 6))
        first[:, :3] = self.curve.at(distance, 1)
        second[:, :3] = self.curve.at(distance, 2)
        if self.orientation == TANGENT:
            tool = rpy_rotation(self.start_rpy)
            along = np.array([self.curve.at(distance, order) for order in (1, 2, 3)])
            seen = rotated(transposed(tool), along)
            x, dx, ddx = seen[:, :, 0]
            y, dy, ddy = seen[:, :, 1]
            horizontal = x * x + y * y
            rate = (x * dy - y * dx) / horizontal
            change = (x * ddy - y * ddx) / horizontal - 2.0 * rate * (x * dx + y * dy) / horizontal
            first[:, 3:] = rate[:, None] * tool[:, 2]
            second[:, 3:] = change[:, None] * tool[:, 2]
        if self.orientation == INTERPOLATED:
            for rows, _, turn, share in self._turns(distance):
                first[rows, 3:], second[rows, 3:] = (each[:, None] * turn for each in share[1:])
        return first, second

    def error(self, tip: Array, near: Array | None = None) -> PathError:
        """Return the distance of positions (n, 3) m of the tool centre point from the path.

        `near`, distances (n,) m along the path, limits the search to their neighbourhood.
        """
        return self.curve.error(tip, near)

    def notes(self) -> list[str]:
        """Return lines of text for a person: where the tool stops, and lowered values."""
        inner = [f"{at:.3f}" for at in self.stops[1:-1]]
        stops = (
            [f"stops     {len(inner)}, at {', '.join(inner[:6])}{', ...' * (len(inner) > 6)} m"]
            if inner
            else []
        )
        return [*stops, *(f"limits    {remark}" for remark in self.remarks)]

    def within_limits(
        self,
        names: Sequence[str],
        distance: Array,
        slope: Array,
        bend: Array,
        velocity: Array,
        most: Array,
    ) -> Path:
        """Return the path with speeds, and the acceleration, at which no joint exceeds its limits.

        Both are lowered in blocks of some millimetres, so that the speed stays even within one.

        Args:
            names: of the joints.
            distance: places, m, shape (k,).
            slope: of the joints by the distance there, rad/m, shape (k, n).
            bend: their second derivative, rad/m², shape (k, n).
            velocity: limits, rad/s, shape (n,).
            most: limits of the acceleration, rad/s², shape (n,); infinite for none.
        """
        slope = np.abs(slope)
        bend = np.abs(bend)
        requested = np.full(len(distance), np.inf)
        for one in self._limits:
            within = (distance >= one.begin) & (distance <= one.end)
            requested[within] = np.minimum(requested[within], one.speed)
        velocity = _SPEED_RESERVE * velocity
        most = _RESERVE * most
        short = slope * self.acceleration + bend * requested[:, None] ** 2 > most
        with np.errstate(divide="ignore", invalid="ignore"):
            allowed = np.where(short, _ACCELERATION_SHARE * most / slope, np.inf)
            acceleration = np.minimum(allowed.min(axis=1), self.acceleration)
            turning = velocity / slope
            rest = np.maximum(most - slope * acceleration[:, None], 0.0)
            bending = np.where(bend > 0.0, np.sqrt(rest / bend), np.inf)
        both = np.stack([turning, bending])
        possible = both.min(axis=(0, 2))
        lowered = list[SpeedLimit]()
        remarks = list[str]()
        for one in self._limits:
            rows = np.flatnonzero((distance >= one.begin) & (distance <= one.end))
            slow = rows[(possible[rows] < one.speed) | (acceleration[rows] < self.acceleration)]
            if not len(slow):
                continue
            count = max(1, min(_BLOCKS, int((one.end - one.begin) / _BLOCK)))
            for begin, end in pairwise(np.linspace(one.begin, one.end, count + 1).tolist()):
                low, high = np.searchsorted(distance, [begin, end])
                near = slice(max(low - 1, 0), high + 1)
                speed = float(possible[near].min())
                ramp = float(acceleration[near].min())
                if speed < one.speed or ramp < self.acceleration:
                    lowered.append(SpeedLimit(begin, end, min(speed, one.speed), ramp))
            places = f"from {distance[slow[0]]:.3f} to {distance[slow[-1]]:.3f} m"
            lowest = slow[np.argmin(possible[slow])]
            least = slow[np.argmin(acceleration[slow])]
            if possible[lowest] < one.speed:
                kind, j = divmod(int(np.argmin(both[:, lowest])), len(names))
                limit = f"{names[j]} reaches its {('velocity', 'acceleration')[kind]} limit"
                if self.speed_policy == HOLD:
                    raise LineError(
                        f"at {distance[lowest]:.3f} m {limit}: {possible[lowest]:.3g} m/s there in place of "
                        f"{one.speed:.4g}; accepted with speed_policy {HOLD}: up to that speed, or speed_policy {LOWER}"
                    )
                remarks.append(f"slowed to {possible[lowest]:.3g} m/s {places}: {limit}")
            if acceleration[least] < self.acceleration:
                limit = f"{names[int(np.argmin(allowed[least]))]} reaches its acceleration limit"
                remarks.append(f"ramps of {acceleration[least]:.3g} m/s^2 {places}: {limit}")
        return replace(self, lowered=tuple(lowered), remarks=tuple(remarks)) if lowered else self
