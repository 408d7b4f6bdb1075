"""Paths from other programs' files: points in a CSV file, DXF drawings.

DXF: LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE and SPLINE, joined end to end; splines by points on them, from one corner
to the next, such that the curve through these points stays within SPLINE_TOLERANCE of them.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, TypeAlias

import numpy as np
from pydantic import Field

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import ConfigError, warn_caller
from rx90_common.base.models import FileModel, Triple, quantity
from rx90_common.base.quoting import counted, plain, quoted
from rx90_common.base.text_lines import read_bytes, read_lines
from rx90_common.description.rotations import angle_between, length, rpy_rotation
from rx90_controller.lines.task import Angles, radians
from rx90_controller.paths.curve import KINK, spline_through
from rx90_controller.paths.path import Segment

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 25.4e-3}
"""Units of drawings, m."""
_DXF_UNITS = {1: "in", 4: "mm", 5: "cm", 6: "m"}
_MOST_POINTS = 50_000  # what a spline through them needs is some 200 MB
_MOST_DXF_LINES = 2_000_000  # two a tag; an entity takes a few, and some 400 bytes
_JOIN_TOLERANCE = 1e-4  # of the drawing's unit: ends closer than this are one
SPLINE_TOLERANCE = 1e-5
"""How far a path may be off a drawing's spline, m."""
_POINTS_PER_SPAN = 12  # least number of points on each span of a drawing's spline
_ROUNDS = 40  # in which an interval between points may be halved
_BETWEEN = np.linspace(0.0, 1.0, 9)[1:-1]  # where a spline is compared between two points
_KEPT = 0.9  # of the tolerance there: in between it may be a little farther off
_UNEVEN = 0.25  # of the way between two points
_NEWTON = 3  # steps to the nearest place
_SLOWEST = 1e-6  # square of the speed by the parameter, which is that along the chords
_STRAIGHT = 1e-9  # of the length of a spline: how far a straight one may be off its chord
# rad, between secants of a spline before and behind a knot, each over _SECANT of its span
_CORNER = 0.02
_SECANT = 1e-3
_HEAD = re.compile(r"\s*(\w+)\s*(?:\[\s*(\w+)\s*\])?\s*")


def _cells(file: Path, delimiter: str, lines: Sequence[str], asked: str) -> Iterator[list[str]]:
    try:
        yield from csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    except csv.Error as error:
        raise ConfigError(f"{plain(file)}: {error}; accepted: lines of {asked}") from error


def read_columns(file: Path, names: Sequence[str]) -> tuple[Array, list[str | None]]:
    """Read columns of a CSV file, whose delimiter is found, and whose lines with # are comments.

    Args:
        file: its titles are names, each with or without a unit: `x [mm]`. Without titles it has these columns alone.
        names: of the columns.

    Returns:
        The numbers, (n, columns), and the unit that each title has.
    """
    lines = read_lines(file)
    asked = ", ".join(names)
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    delimiter = next((each for each in ",;\t" if each in first), " ")
    rows: list[list[float]] = []
    columns = list(range(len(names)))
    units = list[str | None]()
    for number, row in enumerate(_cells(file, delimiter, lines, asked), 1):
        cells = [cell for cell in row if cell.strip()] if delimiter == " " else row
        if not any(cell.strip() for cell in cells) or cells[0].lstrip().startswith("#"):
            continue
        heads = [_HEAD.fullmatch(cell) for cell in cells]
        titles = [head[1].lower() if head else "" for head in heads]
        if not rows and not units and set(titles) & set(names):
            if any(titles.count(name) != 1 for name in names):
                raise ConfigError(
                    f"{plain(file)}: line {number} is {quoted(', '.join(cells))}; accepted: the columns {asked} once"
                )
            columns = [titles.index(name) for name in names]
            units = [head[2] for k in columns if (head := heads[k])]
            continue
        try:
            point = [float(cells[k]) for k in columns]
            good = all(map(math.isfinite, point)) and (bool(units) or len(cells) == len(names))
        except (ValueError, IndexError):
            good = False
        if not good:
            raise ConfigError(
                f"{plain(file)}: line {number} is {quoted(', '.join(cells))}; accepted: finite numbers, {asked}"
            )
        rows.append(point)
    return np.array(rows, dtype=np.float64).reshape(-1, len(names)), units or [None] * len(names)


class Drawing(FileModel):
    """A file with the path: points (.csv) or a drawing (.dxf)."""

    name: Annotated[str, Field(description="The file, beside this one.")]
    unit: Annotated[
        Literal["m", "mm", "cm", "in"] | None, Field(description="Unit of its numbers.")
    ] = None
    origin: Annotated[Triple, quantity("m", "Where its origin lies, in base_link.")] = (
        0.0,
        0.0,
        0.0,
    )
    rpy_degrees: Annotated[Angles, quantity("deg", "Roll, pitch and yaw of its axes.")] = (
        0.0,
        0.0,
        0.0,
    )
    points: Annotated[
        Literal["lines", "spline"],
        Field(description="Points of a CSV file as the corners of lines, or on a spline."),
    ] = "spline"
    layer: Annotated[str | None, Field(description="Layer of the drawing; all if left out.")] = None
    zone: Annotated[float, quantity("m", "Zone at each corner.", ge=0.0)] = 0.0

    @property
    def file(self) -> Path:
        """Return where it is."""
        return Path(self.name)

    def read(self) -> tuple[tuple[float, ...], tuple[Segment, ...]]:
        """Return the start, m, and the segments of a path."""
        kind = self.file.suffix.lower()
        if kind not in (".csv", ".dxf"):
            self._refuse(f"ends with {quoted(kind)}; accepted: .csv, .dxf")
        if self.layer is not None and kind != ".dxf":
            self._refuse("layer of a file without layers; accepted: of .dxf")
        unit, start, segments = self._dxf() if kind == ".dxf" else self._csv()
        if not segments:
            self._refuse("holds no path; accepted: two different points or more")
        turn = rpy_rotation(radians(self.rpy_degrees))
        origin = np.array(self.origin)

        def placed(point: Any) -> tuple[float, ...]:
            return tuple(
                (turn @ (np.array(point, dtype=np.float64) * UNITS[unit]) + origin).tolist()
            )

        found = [
            replace(
                one,
                points=tuple(placed(point) for point in one.points),
                center=None if one.center is None else placed(one.center),
                normal=tuple((turn @ np.array(one.normal)).tolist()),
            )
            for one in segments
        ]
        return placed(start), self._rounded(placed(start), found)

    def _rounded(self, start: tuple[float, ...], segments: list[Segment]) -> tuple[Segment, ...]:
        """Return the segments with a zone at each corner."""
        if self.zone == 0.0:
            return tuple(segments)
        starts = [start, *(one.points[-1] for one in segments)]
        pieces = [one.piece(begin) for one, begin in zip(segments, starts[:-1], strict=True)]
        rounded = []
        for one, piece, after in zip(segments[:-1], pieces[:-1], pieces[1:], strict=True):
            last = piece.at(np.array([piece.length]), 1)[0]
            first = after.at(np.zeros(1), 1)[0]
            turn = float(angle_between(last, first))
            zone = (
                min(self.zone, 0.5 * piece.length, 0.5 * after.length)
                if KINK < turn < math.radians(168.0)
                else 0.0
            )
            rounded.append(replace(one, zone=zone))
        return (*rounded, segments[-1])

    def _refuse(self, text: str) -> NoReturn:
        raise ConfigError(f"{plain(self.file)}: {text}")

    def _check_count(self, count: int) -> None:
        if count > _MOST_POINTS:
            self._refuse(f"holds {count:,} points; accepted: up to {_MOST_POINTS:,}")

    def _csv(self) -> tuple[str, Any, list[Segment]]:
        table, units = read_columns(self.file, "xyz")
        self._check_count(len(table))
        if len(set(units)) > 1 or units[0] not in (None, *UNITS):
            named = ", ".join(str(unit) for unit in units)
            self._refuse(f"units {named}; accepted: one of {', '.join(UNITS)} for all")
        unit = self._unit(units[0])
        rows = [tuple(row) for row in table.tolist()]
        if len(rows) < 2:
            self._refuse(f"holds {counted(len(rows), 'point')}; accepted: two or more")
        for number, (a, b) in enumerate(pairwise(rows), 1):
            if a == b:
                self._refuse(
                    f"points {number} and {number + 1} are both {a}; accepted: different points"
                )
        if self.points == "spline" and len(rows) > 2:
            return unit, rows[0], [Segment(tuple(rows[1:]), "spline")]
        return unit, rows[0], [Segment((row,)) for row in rows[1:]]

    def _unit(self, named: str | None) -> str:
        """Return the unit of the file's numbers, which the file or the user names."""
        if self.unit is None and named not in UNITS:
            said = "names no unit" if named is None else f"is in {named}"
            self._refuse(f"{said}; accepted: with unit, one of {', '.join(UNITS)}")
        if None not in (named, self.unit) and named != self.unit:
            self._refuse(f"is in {named}, unit is {self.unit}; accepted: the same")
        return str(named or self.unit)

    def _dxf(self) -> tuple[str, Any, list[Segment]]:
        from ezdxf.filemanagement import readfile  # here, because only drawings need it
        from ezdxf.lldxf.const import DXFError

        content = read_bytes(self.file)
        lines = sum(content.count(end) for end in (b"\n", b"\r", b"\0")) - content.count(b"\r\n")
        if lines > _MOST_DXF_LINES:
            self._refuse(f"holds {lines:,} lines; accepted: up to {_MOST_DXF_LINES:,}")
        try:
            document = readfile(self.file)
            space = document.modelspace()
            unit = self._dxf_unit(document, content)
            drawn = [
                one
                for entity in space
                if self.layer is None or entity.dxf.layer == self.layer
                for one in self._entity(entity, UNITS[unit])
            ]
        except StopIteration as error:
            raise ConfigError(
                f"{plain(self.file)}: ends within its header; accepted: a whole DXF file"
            ) from error
        except (
            OSError,
            ValueError,
            LookupError,
            ArithmeticError,
            TypeError,
            AttributeError,
            DXFError,
        ) as error:
            raise ConfigError(
                f"{plain(self.file)}: cannot be read ({error}); accepted: a DXF file"
            ) from error
        if not drawn:
            known = sorted({entity.dxf.layer for entity in space})
            where = (
                ""
                if self.layer is None
                else f" on the layer {quoted(self.layer)} (there are {', '.join(known)})"
            )
            self._refuse(f"holds no path{where}; accepted: lines, arcs and splines")
        self._check_count(sum(len(segment.points) for _, segment in drawn))
        return unit, *self._chained(drawn)

    def _dxf_unit(self, document: Any, content: bytes) -> str:
        """Return the user's unit, else that of the drawing; ezdxf has one also for a drawing without header."""
        from ezdxf.units import unit_name

        named = None
        code = document.header.get("$INSUNITS", 0)
        if unit_name(code) != unit_name(0) and (9, "$INSUNITS") in self._tags(content):
            named = _DXF_UNITS.get(code, unit_name(code))
        if self.unit is None or self.unit == named:
            return self._unit(named)
        said = "names no unit" if named is None else f"is in {named}"
        warn_caller(
            [f"{plain(self.file)}: {said}; read in {self.unit}, as its unit in the path says"]
        )
        return self.unit

    def _tags(self, content: bytes) -> Iterator[Any]:
        """Return the group codes and values of the DXF file, without its comments."""
        from ezdxf.lldxf.tagger import ascii_tags_loader, binary_tags_loader
        from ezdxf.lldxf.validator import is_binary_dxf_file

        if is_binary_dxf_file(str(self.file)):
            return binary_tags_loader(content)
        return ascii_tags_loader(
            io.TextIOWrapper(io.BytesIO(content), encoding="utf-8", errors="replace")
        )

    def _entity(self, entity: Any, unit: float) -> list[_Drawn]:
        """Return what an entity draws, in its order; the drawing's unit is in m."""
        kind = entity.dxftype()
        dxf = entity.dxf
        if kind == "LINE":
            start = tuple(dxf.start)
            end = tuple(dxf.end)
            return [(start, Segment((end,)))] if start != end else []
        if kind in ("ARC", "CIRCLE"):
            ocs = entity.ocs()
            if kind == "ARC":
                first = tuple(entity.start_point)
                last = tuple(entity.end_point)
            else:
                first = last = tuple(
                    ocs.to_wcs(dxf.center + type(dxf.center)(dxf.radius, 0.0, 0.0))
                )
            return [
                (
                    first,
                    Segment((last,), "arc", tuple(ocs.to_wcs(dxf.center)), tuple(dxf.extrusion)),
                )
            ]
        if kind in ("LWPOLYLINE", "POLYLINE"):
            return [part for each in entity.virtual_entities() for part in self._entity(each, unit)]
        if kind == "SPLINE":
            return self._spline(entity.construction_tool(), unit)
        if kind not in ("TEXT", "MTEXT", "DIMENSION", "POINT", "HATCH"):  # which draw no path
            self._refuse(
                f"{kind} on the layer {quoted(dxf.layer)}; accepted: LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE, SPLINE"
            )
        return []

    def _spline(self, curve: Any, unit: float) -> list[_Drawn]:
        """Return the parts of a drawing's spline from corner to corner, each through as many points as it takes."""
        known = curve.knots()
        if not (
            np.isfinite(known).all()
            and np.diff(known).min() >= 0.0 < known[curve.count] - known[curve.degree]
        ):
            self._refuse(
                f"a spline with the knots {quoted(known)}; accepted: finite numbers, none below the one before it"
            )
        if curve.is_rational and not (
            np.isfinite(curve.weights()).all() and min(curve.weights()) > 0.0
        ):
            self._refuse(
                f"a spline with the weights {quoted(curve.weights())}; accepted: finite numbers > 0"
            )
        if not np.isfinite(np.array([tuple(point) for point in curve.control_points])).all():
            self._refuse("a spline with a point that is no place; accepted: finite coordinates")
        # before and behind these it is not defined
        knots = sorted({*known[curve.degree : curve.count + 1]})
        corners = [
            knot
            for before, knot, after in zip(knots, knots[1:], knots[2:], strict=False)
            if _turns(curve, before, knot, knot, after)
        ]
        drawn = []
        for begin, end in pairwise([knots[0], *corners, knots[-1]]):
            inner = [knot for knot in knots if begin <= knot <= end]
            shares = np.linspace(0.0, 1.0, _POINTS_PER_SPAN, endpoint=False)
            at = np.append(np.concatenate([a + shares * (b - a) for a, b in pairwise(inner)]), end)
            corner = _turns(curve, inner[-2], end, begin, inner[1])
            points, within = _points(curve, at, unit, corner)
            if not within:
                self._refuse(
                    f"{len(points)} points on a spline do not keep the curve within {SPLINE_TOLERANCE:g} m of it; "
                    f"accepted: a spline that takes up to {_MOST_POINTS:,}"
                )
            rows = [tuple(point) for point in points.tolist()]
            if len(rows) < 2:  # it rests
                continue
            if _off_chord(points) <= _STRAIGHT * np.ptp(points, axis=0).max():
                drawn.append((rows[0], Segment((rows[-1],))))
            else:
                drawn.append((rows[0], Segment(tuple(rows[1:]), "spline", corner=corner)))
        return drawn

    def _chained(self, drawn: list[_Drawn]) -> tuple[tuple[float, ...], list[Segment]]:
        """Return start and segments end to end, from an open end, else from the start of the first one."""
        from ezdxf.edgeminer import Deposit, find_simple_chain, make_edge, reverse_chain

        edges = [make_edge(start, segment.points[-1], payload=segment) for start, segment in drawn]
        if not all(math.isfinite(edge.length) for edge in edges):
            self._refuse("has an end that is no place; accepted: finite coordinates")
        found = find_simple_chain(Deposit(edges, gap_tol=_JOIN_TOLERANCE), edges[0])
        chain = list(dict.fromkeys(found))  # a circle comes twice
        if len(chain) < len(edges):
            left = len(edges) - len(chain)
            ends = f"from {tuple(chain[0].start)} to {tuple(chain[-1].end)}"
            self._refuse(
                f"is one path {ends}, and {left} entities beside it; accepted: one path without branches"
            )
        if chain[-1].id < chain[0].id:
            chain = reverse_chain(chain)
        segments = []
        for edge in chain:
            segment = edge.payload
            if edge.is_reverse:
                points = (*segment.points[-2::-1], tuple(edge.end))
                segment = replace(segment, points=points, normal=tuple(-x for x in segment.normal))
            segments.append(segment)
        return tuple(chain[0].start), segments


_Drawn: TypeAlias = tuple[tuple[float, ...], Segment]
"""A start and a segment from there."""


def _turns(curve: Any, before: float, end: float, begin: float, after: float) -> bool:
    """Return whether a drawing's spline has a corner where its span up to `end` meets the one from `begin`."""
    last = np.array(curve.point(end) - curve.point(end - _SECANT * (end - before)))
    first = np.array(curve.point(begin + _SECANT * (after - begin)) - curve.point(begin))
    return float(angle_between(last, first)) > _CORNER


def _points(curve: Any, at: Array, unit: float, corner: bool) -> tuple[Array, bool]:
    """Return points (n, 3) of a drawing's spline, and whether the curve through them is within SPLINE_TOLERANCE of it.

    Where it is not, there are more of them: in the middle of the parameters `at` on both sides. A spline that comes
    back to its start has a corner there, or goes over into itself.
    """
    for _ in range(_ROUNDS):
        points = _places(curve, at)
        if np.abs(points[-1] - points[0]).max() <= _STRAIGHT * np.ptp(points, axis=0).max():
            points[-1] = points[0]
        # a spline may rest on equal control points
        moves = np.append(True, np.any(np.diff(points, axis=0), axis=1))
        points = points[moves]
        at = at[moves]
        if len(at) < 2:
            return points, True
        between = at[:-1, None] + np.diff(at)[:, None] * _BETWEEN
        places = _places(curve, between.ravel()).reshape(*between.shape, 3)
        far = _far(unit * points, unit * places, corner)
        if not far.any():
            return points, True
        if len(at) > _MOST_POINTS:
            break
        at = np.sort(np.append(at, 0.5 * (at[:-1] + at[1:])[far]))
    return points, False


def _places(curve: Any, at: Array) -> Array:
    return np.array([tuple(point) for point in curve.points(at.tolist())])


def _far(points: Array, places: Array, corner: bool) -> Mask:
    """Return whether the path between two of the points (n, 3), m, is too far off places (n - 1, k, 3) there, (n - 1,).

    Where places are unevenly far from each other they do not show it, which counts as too far.
    """
    through = spline_through(points, corner)
    begin = through.x[:-1, None]
    end = through.x[1:, None]
    ways = length(
        np.diff(np.concatenate([points[:-1, None], places, points[1:, None]], axis=1), axis=1)
    )
    whole = ways.sum(axis=1, keepdims=True)
    at = begin + (end - begin) * np.cumsum(ways[:, :-1], axis=1) / whole
    for _ in range(_NEWTON):
        slope = through(at, 1)
        nearer = np.sum((places - through(at)) * slope, axis=2) / np.maximum(
            np.sum(slope * slope, axis=2), _SLOWEST
        )
        at = np.clip(at + nearer, begin, end)
    off = length(places - through(at)).max(axis=1)
    uneven = ways.max(axis=1) > np.maximum(_UNEVEN * whole[:, 0], SPLINE_TOLERANCE)
    return np.asarray((off > _KEPT * SPLINE_TOLERANCE) | uneven)


def _off_chord(points: Array) -> float:
    """Return how far points on a way lie off the line to its end, or how far they go back on it."""
    chord = points[-1] - points[0]
    size = float(np.linalg.norm(chord))
    if size == 0.0:
        return math.inf
    along = (points - points[0]) @ chord / size
    across = np.linalg.norm(points - points[0] - along[:, None] * chord / size, axis=1)
    return max(float(across.max()), float(-np.diff(along).min()))
