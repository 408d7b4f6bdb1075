"""Paths from other programs' files: points in a CSV file, DXF drawings.

DXF: LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE and SPLINE, joined end to end; splines by points on them, from one corner
to the next, so close that the curve through these points stays within SPLINE_TOLERANCE of them.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, TypeAlias

import numpy as np
from pydantic import Field

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, Rx90Error, located, warn_caller
from rx90_common.base.models import FileModel, Triple, quantity
from rx90_common.base.quoting import counted, one_line, plain, quoted
from rx90_common.base.text_lines import read_bytes, read_lines
from rx90_common.description.rotations import angle_between, length, rpy_rotation
from rx90_controller.lines.task import Angles, Vector, radians
from rx90_controller.paths.curve import KINK
from rx90_controller.paths.path import Segment

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 25.4e-3}
"""Units of drawings, m."""
_DXF_UNITS = {1: "in", 4: "mm", 5: "cm", 6: "m"}
_MOST_POINTS = 50_000  # what a spline through them needs is some 200 MB
_MOST_DXF_BYTES = 8 << 20  # ezdxf takes up to 50 bytes of memory for one
_JOIN_TOLERANCE = 1e-4  # of the drawing's unit: ends closer than this are one
SPLINE_TOLERANCE = 1e-5
"""How far a path may be off a drawing's spline, m."""
_CHORDS = 4  # least number of points on each span of a drawing's spline
_GROWTH = 4.0  # from one chord to the next: a cubic spline overshoots beside a much shorter one
_ROUNDS = 40  # in which an interval between points may be halved
# rad, between secants of a spline before and behind a knot, each over _SECANT of its span
_CORNER = 0.02
_SECANT = 1e-3
_SHARPEST = math.radians(168.0)  # turn at a corner that a zone rounds
_TITLE = re.compile(r"\s*(\w+)\s*(?:\[\s*(\w+)\s*\])?\s*")


def read_columns(file: Path, names: Sequence[str]) -> tuple[Array, list[str | None]]:
    """Read columns of a CSV file, whose delimiter is found, and whose lines with # are comments.

    Args:
        file: its titles are names, each with or without a unit: `x [mm]`. Without titles it has these columns alone.
        names: of the columns.

    Returns:
        The numbers, (n, columns), and the unit that each title has.
    """
    lines = [
        (number, line)
        for number, line in enumerate(read_lines(file), 1)
        if line.strip(",; \t\n") and not line.lstrip().startswith("#")
    ]
    head = lines[0][1] if lines else ""
    delimiter = next((mark for mark in ",;\t" if mark in head), " ")
    titles = [_TITLE.fullmatch(cell) for cell in _cells(head, delimiter)]
    known = [title[1].lower() if title else "" for title in titles]
    asked = ", ".join(names)
    columns = list(range(len(names)))
    units: list[str | None] = [None] * len(names)
    titled = not set(known).isdisjoint(names)
    if titled:
        if any(known.count(name) != 1 for name in names):
            raise ConfigError(
                f"{plain(file)}: the titles {quoted(head)}; accepted: the columns {asked} once"
            )
        columns = [known.index(name) for name in names]
        units = [title[2] for k in columns if (title := titles[k])]
        del lines[0]
    rows = []
    for number, line in lines:
        cells = _cells(line, delimiter)
        try:
            row = [float(cells[k]) for k in columns]
            good = all(map(math.isfinite, row)) and (titled or len(cells) == len(names))
        except (ValueError, IndexError):
            good = False
        if not good:
            raise ConfigError(
                f"{plain(file)}: line {number} is {quoted(', '.join(cells))}; accepted: finite numbers, {asked}"
            )
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, len(names)), units


def _cells(line: str, delimiter: str) -> list[str]:
    cells = next(csv.reader([line.strip("\n")], delimiter=delimiter, skipinitialspace=True), [])
    return [cell for cell in cells if cell.strip()] if delimiter == " " else cells


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

    def read(self) -> tuple[Vector, tuple[Segment, ...]]:
        """Return the start, m, and the segments of a path."""
        readers = {".csv": self._csv, ".dxf": self._dxf}
        kind = self.file.suffix.lower()
        if kind not in readers:
            self._refuse(f"ends with {quoted(kind)}; accepted: {', '.join(readers)}")
        if self.layer is not None and kind != ".dxf":
            self._refuse("layer of a file without layers; accepted: of .dxf")
        unit, start, segments = readers[kind]()
        count = sum(len(segment.points) for segment in segments)
        if count > _MOST_POINTS:
            self._refuse(f"holds {count:,} points; accepted: up to {_MOST_POINTS:,}")
        turn = rpy_rotation(radians(self.rpy_degrees))

        def placed(point: Any) -> Vector:
            return tuple((turn @ np.multiply(point, UNITS[unit]) + self.origin).tolist())

        laid = [
            replace(
                segment,
                points=tuple(map(placed, segment.points)),
                center=None if segment.center is None else placed(segment.center),
                normal=tuple((turn @ segment.normal).tolist()),
            )
            for segment in segments
        ]
        return placed(start), self._rounded(placed(start), laid)

    def _rounded(self, start: Vector, segments: list[Segment]) -> tuple[Segment, ...]:
        """Return the segments with a zone at each corner, up to half of a neighbour, but where the path turns back."""
        if self.zone == 0.0:
            return tuple(segments)
        pieces = []
        for number, segment in enumerate(segments):
            with located(f"{plain(self.file)}: segment {number} ({segment.kind})"):
                pieces.append(segment.piece(start))
            start = segment.points[-1]
        rounded = []
        for segment, (piece, after) in zip(segments, pairwise(pieces), strict=False):
            ends = piece.at(np.array([piece.length]), 1)[0], after.at(np.zeros(1), 1)[0]
            corner = KINK < angle_between(*ends) < _SHARPEST
            most = 0.5 * min(piece.length, after.length) if corner else 0.0
            rounded.append(replace(segment, zone=min(self.zone, most)))
        return (*rounded, segments[-1])

    def _refuse(self, text: str) -> NoReturn:
        raise ConfigError(f"{plain(self.file)}: {text}")

    def _csv(self) -> tuple[str, Any, list[Segment]]:
        table, units = read_columns(self.file, "xyz")
        if len(set(units)) > 1 or units[0] not in (None, *UNITS):
            named = ", ".join(str(unit) for unit in units)
            self._refuse(f"units {named}; accepted: one of {', '.join(UNITS)} for all")
        if None not in (units[0], self.unit) and units[0] != self.unit:
            self._refuse(f"is in {units[0]}, unit is {self.unit}; accepted: the same")
        unit = self._unit(units[0])
        start, *rows = [tuple(row) for row in table.tolist()] or [()]
        if not rows:
            self._refuse(f"holds {counted(len(table), 'point')}; accepted: two or more")
        if self.points == "spline" and len(rows) > 1:
            return unit, start, [Segment(tuple(rows), "spline")]
        return unit, start, [Segment((row,)) for row in rows]

    def _unit(self, named: str | None) -> str:
        """Return the user's unit, else that of the file."""
        said = "names no unit" if named is None else f"is in {named}"
        if self.unit is None:
            if named not in UNITS:
                self._refuse(f"{said}; accepted: with unit, one of {', '.join(UNITS)}")
            return named
        if named not in (None, self.unit):
            warn_caller(
                [f"{plain(self.file)}: {said}; read in {self.unit}, as its unit in the path says"]
            )
        return self.unit

    def _dxf(self) -> tuple[str, Any, list[Segment]]:
        from ezdxf.filemanagement import readfile  # here, because only drawings need it

        content = read_bytes(self.file, _MOST_DXF_BYTES)
        try:
            space = readfile(self.file).modelspace()
            unit = self._dxf_unit(content)
            layers = {entity.dxf.layer for entity in space}
            drawn = [
                part
                for entity in space
                if self.layer in (None, entity.dxf.layer)
                for part in self._entity(entity, UNITS[unit])
            ]
        except Rx90Error:
            raise
        except Exception as error:  # ezdxf stumbles over damaged files in many ways
            self._refuse(f"cannot be read ({one_line(error)}); accepted: a DXF file")
        if not drawn:
            known = ", ".join(sorted(layers))
            self._refuse(
                f"holds no path on its layer; accepted: lines, arcs and splines on {known}"
            )
        return unit, *self._chained(drawn)

    def _dxf_unit(self, content: bytes) -> str:
        from ezdxf.lldxf.validator import binary_dxf_info, dxf_info
        from ezdxf.units import unit_name

        if content.startswith(b"AutoCAD Binary DXF"):
            code = binary_dxf_info(content).insert_units
        else:
            code = dxf_info(io.StringIO(content.decode(errors="replace"))).insert_units
        return self._unit(_DXF_UNITS.get(code, unit_name(code)) if code else None)

    def _entity(self, entity: Any, unit: float) -> list[_Drawn]:
        """Return what an entity draws, in its order; the drawing's unit is in m."""
        kind = entity.dxftype()
        dxf = entity.dxf
        if kind == "LINE":
            return [(tuple(dxf.start), Segment((tuple(dxf.end),)))] if dxf.start != dxf.end else []
        if kind in ("ARC", "CIRCLE"):
            angles = (dxf.start_angle, dxf.end_angle) if kind == "ARC" else (0.0, 0.0)
            first, last = entity.vertices(angles)
            center = tuple(entity.ocs().to_wcs(dxf.center))
            return [(tuple(first), Segment((tuple(last),), "arc", center, tuple(dxf.extrusion)))]
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
        knots = np.array(curve.knots())
        if not np.diff(knots).min() >= 0.0 < knots[curve.count] - knots[curve.degree]:
            self._refuse(
                f"a spline with the knots {quoted(knots)}; accepted: finite numbers, none below the one before it"
            )
        knots = np.unique(knots[curve.degree : curve.count + 1])  # beyond these it is not defined
        inner = zip(knots, knots[1:], knots[2:], strict=False)
        corners = [
            knot for before, knot, after in inner if _turns(curve, before, knot, knot, after)
        ]
        drawn: list[_Drawn] = []
        for begin, end in pairwise([knots[0], *corners, knots[-1]]):
            part = knots[(knots >= begin) & (knots <= end)]
            start, *points = self._points(curve, part, SPLINE_TOLERANCE / unit)
            corner = _turns(curve, part[-2], end, begin, part[1])
            if len(points) == 1:
                drawn.append((start, Segment((points[0],))))
            elif points:
                drawn.append((start, Segment(tuple(points), "spline", corner=corner)))
        return drawn

    def _points(self, curve: Any, knots: Array, tolerance: float) -> list[Vector]:
        """Return points of a spline, of which no middle between two by the parameter is off the middle of their chord.

        The cubic spline through them is far nearer to the curve than their chords.
        """
        count = _CHORDS * (len(knots) - 1)
        at = np.interp(np.arange(count + 1) / _CHORDS, np.arange(len(knots)), knots)
        for _ in range(_ROUNDS):
            points = _places(curve, at)
            if not np.isfinite(points).all():
                self._refuse("a spline with a point that is no place; accepted: finite numbers")
            chords = length(np.diff(points, axis=0))
            middle = 0.5 * (at[:-1] + at[1:])
            bulge = length(_places(curve, middle) - 0.5 * (points[:-1] + points[1:]))
            neighbour = np.minimum(np.roll(chords, 1), np.roll(chords, -1))
            far = np.maximum(bulge, chords - _GROWTH * neighbour) > tolerance
            if len(at) > _MOST_POINTS or not far.any():
                break
            at = np.sort(np.append(at, middle[far]))
        if far.any():
            self._refuse(
                f"{len(points)} points on a spline do not keep the curve within {SPLINE_TOLERANCE:g} m of it; "
                f"accepted: a spline that takes up to {_MOST_POINTS:,}"
            )
        moves = np.append(True, chords > 0.0)  # not where equal control points let it rest
        return [tuple(point) for point in points[moves].tolist()]

    def _chained(self, drawn: list[_Drawn]) -> tuple[Vector, list[Segment]]:
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


_Drawn: TypeAlias = tuple[Vector, Segment]
"""A start and a segment from there."""


def _places(curve: Any, at: Array) -> Array:
    return np.array([tuple(point) for point in curve.points(at.tolist())])


def _turns(curve: Any, before: float, end: float, begin: float, after: float) -> bool:
    """Return whether a drawing's spline has a corner where its span up to `end` meets the one from `begin`."""
    last = curve.point(end) - curve.point(end - _SECANT * (end - before))
    first = curve.point(begin + _SECANT * (after - begin)) - curve.point(begin)
    return float(angle_between(np.array(tuple(last)), np.array(tuple(first)))) > _CORNER
