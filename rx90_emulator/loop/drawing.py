"""Paths from other programs' files: points in a CSV file, G-code, DXF drawings.

G-code: G0 to G3 in the plane G17, absolute or relative (G90, G91; centres G91.1, G90.1), in mm or inches (G21, G20), as
RS274/NGC has them (Kramer, Proctor, Messina 2000, NISTIR 6556). F is the speed of G1 to G3, per minute; G0 goes at the
path's own speed. The moves by G0 at the beginning lead to the start. M, S, T and E words do not move the tool.

DXF: LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE and SPLINE, joined end to end; splines by points on them.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted
from rx90_common.description.rotations import rpy_rotation
from rx90_controller.paths.curve import KINK
from rx90_controller.paths.path import Segment

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 25.4e-3}
"""Units of drawings, m."""
_DXF_UNITS = {1: "in", 4: "mm", 5: "cm", 6: "m"}
_CSV, _GCODE, _DXF = (".csv",), (".nc", ".ngc", ".gcode", ".tap"), (".dxf",)
_MOST_BYTES = 16 << 20
_MOST_POINTS = 50_000  # what a spline through them needs is some 200 MB
_JOIN_TOLERANCE = 1e-4  # of the drawing's unit: ends closer than this are one
_ARC_RADIUS_TOLERANCE = 0.02  # mm: how unequally far from the centre an arc's ends may be, as programs round them
_POINTS_PER_SPAN = 12  # points on each span of a drawing's spline
_WORD = re.compile(r"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*")
_COMMENT = re.compile(r"\([^)]*\)|;.*$")
_HEAD = re.compile(r"\s*(\w+)\s*(?:\[\s*(\w+)\s*\])?\s*")
_IGNORED_G_CODES = {17.0, 40.0, 49.0, 54.0, 61.0, 64.0, 69.0, 80.0, 94.0}
_IGNORED_WORDS = frozenset("MSTENO")
_PRINTERS_M = {73.0, 84.0, 92.0}  # and from M100 on: they set up a printer; the X of M201 X500 is a limit, no move
_SUBPROGRAM_M = 198.0  # in another file


def _sets_up_a_printer(letter: str, value: float) -> bool:
    return letter == "M" and (value >= 100.0 or value in _PRINTERS_M) and value != _SUBPROGRAM_M


def _lines_of(file: Path) -> list[str]:
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise ConfigError(f"{plain(file)}: holds more than {_MOST_BYTES:,} bytes; accepted: up to that")
        return file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{plain(file)}: cannot be read ({error}); accepted: a text file") from error


def read_columns(file: Path, names: Sequence[str]) -> tuple[Array, list[str | None]]:
    """Read columns of a CSV file, whose delimiter is found, and whose lines with # are comments.

    Args:
        file: its titles are names, each with or without a unit: `x [mm]`. Without titles it has these columns alone.
        names: of the columns.

    Returns:
        The numbers, (n, columns), and the unit that each title has.

    Raises:
        ConfigError: naming file and line, what is there and what is accepted.
    """
    lines, asked = _lines_of(file), ", ".join(names)
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    delimiter = next((each for each in ",;\t" if each in first), " ")
    rows: list[list[float]] = []
    columns, units = list(range(len(names))), list[str | None]()
    for number, row in enumerate(csv.reader(lines, delimiter=delimiter, skipinitialspace=True), 1):
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


@dataclass(frozen=True)
class Drawing:
    """A file that a path is read from, and where it lies.

    Attributes:
        file: its name ends with .csv, .nc, .ngc, .gcode, .tap or .dxf.
        unit: of its numbers, one of UNITS; None: that the file names, of G-code without G20 mm.
        origin: where its origin lies, m.
        rpy: roll, pitch and yaw of its axes, rad.
        points: "spline" or "lines" through the points of a CSV file.
        layer: of a drawing; None for all.
        zone: m at each corner, less where a neighbour is shorter than twice that.
    """

    file: Path
    unit: str | None = None
    origin: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    points: str = "spline"
    layer: str | None = None
    zone: float = 0.0

    def read(self) -> tuple[tuple[float, ...], tuple[Segment, ...]]:
        """Return the start, m, and the segments of a path.

        Raises:
            ConfigError: naming file, line or entity, what is wrong and what is accepted.
        """
        kind = self.file.suffix.lower()
        if kind not in (*_CSV, *_GCODE, *_DXF):
            self._refuse(f"ends with {quoted(kind)}; accepted: {', '.join((*_CSV, *_GCODE, *_DXF))}")
        if self.layer is not None and kind not in _DXF:
            self._refuse("layer of a file without layers; accepted: of .dxf")
        reader = self._dxf if kind in _DXF else self._csv if kind in _CSV else self._gcode
        unit, start, segments = reader()
        if not segments:
            self._refuse("holds no path; accepted: two different points or more")
        if (count := sum(len(one.points) for one in segments)) > _MOST_POINTS:
            self._refuse(f"holds {count:,} points; accepted: up to {_MOST_POINTS:,}")
        turn, origin = rpy_rotation(self.rpy), np.array(self.origin)

        def placed(point: Any) -> tuple[float, ...]:
            return tuple((turn @ (np.array(point, dtype=np.float64) * UNITS[unit]) + origin).tolist())

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
            last, first = piece.at(np.array([piece.length]), 1)[0], after.at(np.zeros(1), 1)[0]
            turn = math.atan2(float(np.linalg.norm(np.cross(last, first))), float(last @ first))
            zone = min(self.zone, 0.5 * piece.length, 0.5 * after.length) if KINK < turn < math.radians(168.0) else 0.0
            rounded.append(replace(one, zone=zone))
        return (*rounded, segments[-1])

    def _refuse(self, text: str) -> NoReturn:
        raise ConfigError(f"{plain(self.file)}: {text}")

    def _csv(self) -> tuple[str, Any, list[Segment]]:
        table, units = read_columns(self.file, "xyz")
        if len(set(units)) > 1 or units[0] not in (None, *UNITS):
            named = ", ".join(str(unit) for unit in units)
            self._refuse(f"units {named}; accepted: one of {', '.join(UNITS)} for all")
        unit, rows = self._unit(units[0]), [tuple(row) for row in table.tolist()]
        if len(rows) < 2:
            self._refuse(f"holds {len(rows)} points; accepted: two or more")
        for number, (a, b) in enumerate(pairwise(rows), 1):
            if a == b:
                self._refuse(f"points {number} and {number + 1} are both {a}; accepted: different points")
        if self.points == "spline" and len(rows) > 2:
            return unit, rows[0], [Segment(tuple(rows[1:]), "spline")]
        return unit, rows[0], [Segment((row,)) for row in rows[1:]]

    def _unit(self, named: str | None) -> str:
        """Return the unit of the file's numbers, which the file or the user names."""
        if named is None and self.unit is None:
            self._refuse(f"names no unit; accepted: with unit, one of {', '.join(UNITS)}")
        if None not in (named, self.unit) and named != self.unit:
            self._refuse(f"is in {named}, unit is {self.unit}; accepted: the same")
        return str(named or self.unit)

    def _dxf(self) -> tuple[str, Any, list[Segment]]:
        from ezdxf.filemanagement import readfile  # here, because only drawings need it
        from ezdxf.lldxf.const import DXFError

        try:
            document = readfile(self.file)
            space = document.modelspace()
            unit = self._unit(_DXF_UNITS.get(document.header.get("$INSUNITS", 0)))
            drawn = [
                one
                for entity in space
                if self.layer is None or entity.dxf.layer == self.layer
                for one in self._entity(entity)
            ]
        except (OSError, ValueError, LookupError, ArithmeticError, TypeError, AttributeError, DXFError) as error:
            raise ConfigError(f"{plain(self.file)}: cannot be read ({error}); accepted: a DXF file") from error
        if not drawn:
            known = sorted({entity.dxf.layer for entity in space})
            where = "" if self.layer is None else f" on the layer {quoted(self.layer)} (there are {', '.join(known)})"
            self._refuse(f"holds no path{where}; accepted: lines, arcs and splines")
        return unit, *self._chained(drawn)

    def _entity(self, entity: Any) -> list[_Drawn]:
        """Return what an entity draws, in its order."""
        kind, dxf = entity.dxftype(), entity.dxf
        if kind == "LINE":
            start, end = tuple(dxf.start), tuple(dxf.end)
            return [(start, Segment((end,)))] if start != end else []
        if kind in ("ARC", "CIRCLE"):
            ocs = entity.ocs()
            if kind == "ARC":
                first, last = tuple(entity.start_point), tuple(entity.end_point)
            else:
                first = last = tuple(ocs.to_wcs(dxf.center + type(dxf.center)(dxf.radius, 0.0, 0.0)))
            return [(first, Segment((last,), "arc", tuple(ocs.to_wcs(dxf.center)), tuple(dxf.extrusion)))]
        if kind in ("LWPOLYLINE", "POLYLINE"):
            return [part for each in entity.virtual_entities() for part in self._entity(each)]
        if kind == "SPLINE":
            curve = entity.construction_tool()
            spans = max(1, len(set(curve.knots())) - 1)
            points = [tuple(point) for point in curve.approximate(spans * _POINTS_PER_SPAN)]
            return [(points[0], Segment(tuple(points[1:]), "spline"))]
        if kind not in ("TEXT", "MTEXT", "DIMENSION", "POINT", "HATCH"):  # which draw no path
            self._refuse(
                f"{kind} on the layer {quoted(dxf.layer)}; accepted: LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE, SPLINE"
            )
        return []

    def _chained(self, drawn: list[_Drawn]) -> tuple[tuple[float, ...], list[Segment]]:
        """Return start and segments end to end, from an open end, else from the start of the first one."""
        from scipy.spatial import cKDTree

        ends = np.array([end for start, one in drawn for end in (start, one.points[-1])], dtype=np.float64)
        if not np.isfinite(ends).all():
            self._refuse("has an end that is no place; accepted: finite coordinates")
        touching: list[list[int]] = list(cKDTree(ends).query_ball_point(ends, _JOIN_TOLERANCE))  # type: ignore[arg-type]
        crowded = max(touching, key=len)
        if len(crowded) > 2:
            place = ends[crowded[0]].tolist()
            self._refuse(f"{len(crowded)} ends meet at {place}; accepted: two, one path without branches")
        at = first = next((k for k, each in enumerate(touching) if len(each) == 1), 0)
        found: list[Segment] = []
        left = set(range(len(drawn)))
        while left:
            if at // 2 not in left:
                self._refuse(
                    f"goes on nowhere from {ends[at].tolist()}, {len(left)} entities are left; accepted: one path"
                )
            start, one = drawn[at // 2]
            left.remove(at // 2)
            if at % 2:  # drawn backwards
                normal = tuple(-x for x in one.normal)
                one = replace(one, points=(*one.points[-2::-1], start), normal=normal)
            found.append(one)
            at = next((k for k in touching[at ^ 1] if k // 2 in left), at ^ 1)
        return tuple(ends[first].tolist()), found

    def _gcode(self) -> tuple[str, Any, list[Segment]]:
        program = _Program(self.file, self.unit or "mm")
        for number, line in enumerate(_lines_of(self.file), 1):
            left, words, at = _COMMENT.sub(" ", line).strip(), list[tuple[str, float]](), 0
            if left in ("", "%") or left.startswith("/"):
                continue
            while at < len(left):
                word = _WORD.match(left, at)
                if word is None:
                    self._refuse(f"line {number}: {quoted(left[at : at + 20])}; accepted: words such as G1 or X12.5")
                words.append((word[1].upper(), float(word[2])))
                at = word.end()
            program.execute(number, words)
            if any(word in (("M", 2.0), ("M", 30.0)) for word in words):
                break
        return "mm", program.start.tolist(), program.segments


_Drawn: TypeAlias = tuple[tuple[float, ...], Segment]
"""A start and a segment from there."""


class _Program:
    """A G-code program, line by line.

    Attributes:
        start: where its path begins, mm.
        segments: so far, in mm.
    """

    def __init__(self, file: Path, unit: str) -> None:
        self._file, self._number = file, 0
        self._unit = UNITS[unit] / UNITS["mm"]  # mm, as all lengths here
        self._relative, self._relative_center = False, True
        self._mode: float | None = None
        self._feed: float | None = None  # m/s
        self._at: Array | None = None
        self.start: Array = np.zeros(3)
        self.segments: list[Segment] = []

    def _refuse(self, text: str) -> NoReturn:
        raise ConfigError(f"{plain(self._file)}: line {self._number}: {text}")

    def execute(self, line: int, words: list[tuple[str, float]]) -> None:
        """Execute the words of a line."""
        self._number, numbers, motion = line, dict[str, float](), False
        own = [word for word in words if word[0] != "N"]
        if own and _sets_up_a_printer(*own[0]) and all(letter != "G" for letter, _ in own):
            return
        for letter, value in words:
            if letter == "G":
                motion |= self._code(value, words)
            elif letter in "XYZIJKRF":
                if letter in numbers:
                    self._refuse(f"{letter} stands twice; accepted: once")
                numbers[letter] = value
            elif letter not in _IGNORED_WORDS and not (letter in "PQ" and ("G", 64.0) in words):
                self._refuse(f"{letter}{value:g}; accepted: X, Y, Z, I, J, R, F, and words that do not move")
        if "F" in numbers:
            if not numbers["F"] > 0.0:
                self._refuse(f"F{numbers['F']:g}; accepted: a number > 0")
            self._feed = numbers["F"] * self._unit * UNITS["mm"] / 60.0  # m/s
        if any(axis in numbers for axis in "XYZ") or (motion and "I" in numbers):
            self._move(numbers)

    def _code(self, code: float, words: list[tuple[str, float]]) -> bool:
        """Execute a G word; return whether it is a motion."""
        if code in (0.0, 1.0, 2.0, 3.0):
            self._mode = code
            return True
        if code in (20.0, 21.0):
            self._unit = UNITS["in" if code == 20.0 else "mm"] / UNITS["mm"]
        elif code in (90.0, 91.0):
            self._relative = code == 91.0
        elif code in (90.1, 91.1):
            self._relative_center = code == 91.1
        elif code == 92.0 and {letter for letter, _ in words} <= {"G", "E", "N"}:
            pass  # of a printer's extruder
        elif code not in _IGNORED_G_CODES:
            self._refuse(f"G{code:g}; accepted: G0 to G3, G17, G20, G21, G90, G91, G90.1, G91.1")
        return False

    def _move(self, numbers: dict[str, float]) -> None:
        if self._mode is None:
            self._refuse("moves without G0, G1, G2 or G3; accepted: with one of them")
        before, arc = self._at, self._mode in (2.0, 3.0)
        end = self._at = np.zeros(3) if before is None else before.copy()
        for k, axis in enumerate("XYZ"):
            if axis in numbers:
                end[k] = numbers[axis] * self._unit + (end[k] if self._relative else 0.0)
        if before is None or (not self.segments and self._mode == 0.0):
            if arc:
                self._refuse("an arc from nowhere; accepted: after a G0 or G1")
            self.start = end
            return
        place, speed = (tuple(end.tolist()),), None if self._mode == 0.0 else self._feed
        if arc:
            if end[2] != before[2] or numbers.get("K"):
                self._refuse("an arc that leaves the plane G17; accepted: X, Y, I and J")
            center, normal = self._center(before, end, numbers), (0.0, 0.0, 1.0 if self._mode == 3.0 else -1.0)
            near, far = np.linalg.norm(before - center), np.linalg.norm(end - center)
            if near == 0.0 or abs(near - far) > _ARC_RADIUS_TOLERANCE:
                self._refuse(f"the arc's ends are {near:.6g} and {far:.6g} mm from its centre; accepted: as far")
            self.segments.append(Segment(place, "arc", tuple(center.tolist()), normal, speed=speed))
        elif np.any(end != before):
            self.segments.append(Segment(place, speed=speed))

    def _center(self, start: Array, end: Array, numbers: dict[str, float]) -> Array:
        if "R" in numbers:
            chord, radius = end - start, numbers["R"] * self._unit
            half = 0.5 * float(np.linalg.norm(chord))
            if half == 0.0 or abs(radius) < half * (1.0 - 1e-4):
                self._refuse(
                    f"R{numbers['R']:g} between ends {2.0 * half:g} mm apart; accepted: half of that, or more, between "
                    "different ends"
                )
            height = math.sqrt(max(radius * radius - half * half, 0.0))
            across = np.array([-chord[1], chord[0], 0.0]) / (2.0 * half)
            left = (self._mode == 3.0) == (radius > 0.0)
            return np.asarray(0.5 * (start + end) + (height if left else -height) * across)
        if "I" not in numbers and "J" not in numbers:
            self._refuse("an arc without a centre; accepted: with I and J, or with R")
        offset = np.array([numbers.get("I", 0.0), numbers.get("J", 0.0), 0.0]) * self._unit
        if self._relative_center:
            return np.asarray(start + offset)
        if not {"I", "J"} <= numbers.keys():
            self._refuse("an arc whose centre is absolute (G90.1) has I or J alone; accepted: both")
        return np.asarray(offset + np.array([0.0, 0.0, start[2]]))
