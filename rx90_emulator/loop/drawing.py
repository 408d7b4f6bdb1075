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
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted
from rx90_common.description.rotations import rpy_rotation
from rx90_controller.paths.curve import KINK
from rx90_controller.paths.segment import Segment

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 25.4e-3}
"""Units of drawings, m."""
_DXF_UNITS = {1: "in", 4: "mm", 5: "cm", 6: "m"}
_CSV, _GCODE, _DXF = (".csv",), (".nc", ".ngc", ".gcode", ".tap"), (".dxf",)
_MOST_BYTES = 16 << 20
_MOST_SEGMENTS = 20_000
_JOINED = 1e-4  # of the drawing's unit: ends closer than this are one
_ON_SPLINE = 12  # points on each span of a drawing's spline
_WORD = re.compile(r"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*")
_COMMENT = re.compile(r"\([^)]*\)|;.*$")
_HEAD = re.compile(r"\s*([xyz])\s*(?:\[\s*(\w+)\s*\])?\s*", re.IGNORECASE)
_WITHOUT_MOTION = {17.0, 40.0, 49.0, 54.0, 61.0, 64.0, 69.0, 80.0, 94.0}
_PASSED_OVER = frozenset("MSTENO")


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
        if len(segments) > _MOST_SEGMENTS:
            self._refuse(f"holds {len(segments):,} segments; accepted: up to {_MOST_SEGMENTS:,}")
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

    def _refuse(self, text: str) -> None:
        raise ConfigError(f"{plain(self.file)}: {text}")

    def _text(self) -> str:
        try:
            if self.file.stat().st_size > _MOST_BYTES:
                self._refuse(f"holds more than {_MOST_BYTES:,} bytes; accepted: up to that")
            return self.file.read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{plain(self.file)}: cannot be read ({error}); accepted: a text file") from error

    def _csv(self) -> tuple[str, Any, list[Segment]]:
        text = self._text()
        first = next((line for line in text.splitlines() if line.strip()), "")
        delimiter = next((each for each in ",;\t" if each in first), " ")
        rows: list[tuple[float, ...]] = []
        named, columns = None, [0, 1, 2]
        for number, row in enumerate(csv.reader(text.splitlines(), delimiter=delimiter, skipinitialspace=True), 1):
            cells = [cell for cell in row if cell.strip()] if delimiter == " " else row
            if not any(cell.strip() for cell in cells) or cells[0].lstrip().startswith("#"):
                continue
            heads = [_HEAD.fullmatch(cell) for cell in cells]
            if not rows and any(heads):
                names = [head[1].lower() if head else "" for head in heads]
                if any(names.count(axis) != 1 for axis in "xyz"):
                    self._refuse(f"line {number} is {quoted(', '.join(cells))}; accepted: the columns x, y and z once")
                columns = [names.index(axis) for axis in "xyz"]
                units = {heads[k][2] for k in columns}  # type: ignore[index]
                if len(units) > 1 or units - {None, *UNITS}:
                    told = ", ".join(str(one) for one in units)
                    self._refuse(f"line {number}: units {told}; accepted: one of {', '.join(UNITS)} for all")
                named = units.pop()
                continue
            try:
                point = tuple(float(cells[k]) for k in columns)
                good = all(map(math.isfinite, point)) and (len(cells) == 3 or columns != [0, 1, 2] or named is not None)
            except (ValueError, IndexError):
                good = False
            if not good:
                self._refuse(f"line {number} is {quoted(', '.join(cells))}; accepted: three finite numbers, x, y and z")
            rows.append(point)
        unit = self._unit(named)
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

    def _gcode(self) -> tuple[str, Any, list[Segment]]:
        return _Program(self).read()

    def program_lines(self) -> Iterator[tuple[int, list[tuple[str, float]]]]:
        """Return number and words of each line of a G-code program, as far as M2 or M30."""
        for number, line in enumerate(self._text().splitlines(), 1):
            left = _COMMENT.sub(" ", line).strip()
            if left in ("", "%") or left.startswith("/"):
                continue
            words, at = [], 0
            while at < len(left):
                word = _WORD.match(left, at)
                if word is None:
                    self._refuse(f"line {number}: {quoted(left[at : at + 20])}; accepted: words such as G1 or X12.5")
                    return
                words.append((word[1].upper(), float(word[2])))
                at = word.end()
            yield number, words
            if any(word in (("M", 2.0), ("M", 30.0)) for word in words):
                return

    def _dxf(self) -> tuple[str, Any, list[Segment]]:
        from ezdxf.filemanagement import readfile  # here, because only drawings need it
        from ezdxf.lldxf.const import DXFError

        try:
            document = readfile(self.file)
        except (OSError, UnicodeDecodeError, DXFError) as error:  # an OSError, too, for what is no DXF file
            raise ConfigError(f"{plain(self.file)}: cannot be read ({error}); accepted: a DXF file") from error
        named = _DXF_UNITS.get(document.header.get("$INSUNITS", 0))
        unit = self._unit(named)
        parts: list[_Strand] = []
        for entity in document.modelspace():
            if self.layer is None or entity.dxf.layer == self.layer:
                parts += self._strands(entity)
        if not parts:
            known = sorted({entity.dxf.layer for entity in document.modelspace()})
            where = "" if self.layer is None else f" on the layer {quoted(self.layer)} (there are {', '.join(known)})"
            self._refuse(f"holds no path{where}; accepted: lines, arcs and splines")
        start, segments = self._chained(parts)
        return unit, start, segments

    def _strands(self, entity: Any) -> list[_Strand]:
        """Return what an entity draws, in its order."""
        kind, dxf = entity.dxftype(), entity.dxf
        if kind == "LINE":
            return [_Strand(tuple(dxf.start), Segment((tuple(dxf.end),)))]
        if kind in ("ARC", "CIRCLE"):
            ocs = entity.ocs()
            center, normal = tuple(ocs.to_wcs(dxf.center)), tuple(dxf.extrusion)
            if kind == "ARC":
                first, last = tuple(entity.start_point), tuple(entity.end_point)
            else:
                first = last = tuple(ocs.to_wcs(dxf.center + type(dxf.center)(dxf.radius, 0.0, 0.0)))
            return [_Strand(first, Segment((last,), "arc", center, normal))]
        if kind in ("LWPOLYLINE", "POLYLINE"):
            return [part for each in entity.virtual_entities() for part in self._strands(each)]
        if kind == "SPLINE":
            curve = entity.construction_tool()
            spans = max(1, len(set(curve.knots())) - 1)
            points = [tuple(point) for point in curve.approximate(spans * _ON_SPLINE)]
            return [_Strand(points[0], Segment(tuple(points[1:]), "spline"))]
        if kind in ("TEXT", "MTEXT", "DIMENSION", "POINT", "HATCH"):  # draw no path
            return []
        self._refuse(
            f"{kind} on the layer {quoted(dxf.layer)}; accepted: LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE, SPLINE"
        )
        return []

    def _chained(self, parts: list[_Strand]) -> tuple[tuple[float, ...], list[Segment]]:
        """Return all parts end to end, from an open end, else from the start of the first one."""
        parts = [part for part in parts if part.segment.kind != "line" or not part.closed]
        ends = np.array([[part.start, part.end] for part in parts]).reshape(-1, 3)
        touching = (np.linalg.norm(ends[:, None] - ends[None], axis=2) < _JOINED).sum(axis=1)
        if len(parts) > 1 and (touching > 2).any():
            place = ends[int(np.argmax(touching))].tolist()
            self._refuse(f"{int(touching.max())} ends meet at {place}; accepted: two, one path without branches")
        free = np.flatnonzero(touching == 1)
        first = int(free[0]) if len(free) else 0
        at = ends[first]
        begin, left, found = tuple(at.tolist()), list(range(len(parts))), []
        while left:
            near = [(k, side) for k in left for side in (0, 1) if np.linalg.norm(ends[2 * k + side] - at) < _JOINED]
            if not near:
                self._refuse(f"goes on nowhere from {at.tolist()}, {len(left)} entities are left; accepted: one path")
            k, side = near[0]
            found.append((parts[k] if side == 0 else parts[k].turned()).segment)
            at = ends[2 * k + 1 - side]
            left.remove(k)
        return begin, found


@dataclass(frozen=True)
class _Strand:
    """A segment with its start."""

    start: tuple[float, ...]
    segment: Segment

    @property
    def end(self) -> tuple[float, ...]:
        return self.segment.points[-1]

    @property
    def closed(self) -> bool:
        return self.start == self.end

    def turned(self) -> _Strand:
        """Return it travelled the other way."""
        normal = tuple(-x for x in self.segment.normal)
        points = (*self.segment.points[-2::-1], self.start)
        return _Strand(self.end, replace(self.segment, points=points, normal=normal))


class _Program:
    """A G-code program, line by line."""

    def __init__(self, drawing: Drawing) -> None:
        self._drawing = drawing
        self._unit = UNITS[drawing.unit or "mm"] / UNITS["mm"]  # mm, as all lengths here
        self._relative, self._relative_center = False, True
        self._mode: float | None = None
        self._feed: float | None = None
        self._at: Array | None = None
        self._start: Array | None = None
        self._segments: list[Segment] = []

    def read(self) -> tuple[str, Any, list[Segment]]:
        """Return unit, start and segments."""
        for number, words in self._drawing.program_lines():
            self._line(number, words)
        start = (0.0, 0.0, 0.0) if self._start is None else tuple(self._start.tolist())
        return "mm", start, self._segments

    def _refuse(self, number: int, text: str) -> None:
        raise ConfigError(f"{plain(self._drawing.file)}: line {number}: {text}")

    def _line(self, number: int, words: list[tuple[str, float]]) -> None:
        numbers: dict[str, float] = {}
        motion = False
        for letter, value in words:
            if letter == "G":
                motion |= self._code(number, value, words)
            elif letter in "XYZIJKRF":
                if letter in numbers:
                    self._refuse(number, f"{letter} stands twice; accepted: once")
                numbers[letter] = value
            elif letter not in _PASSED_OVER and not (letter in "PQ" and ("G", 64.0) in words):
                self._refuse(number, f"{letter}{value:g}; accepted: X, Y, Z, I, J, R, F, and words that do not move")
        if "F" in numbers:
            if not numbers["F"] > 0.0:
                self._refuse(number, f"F{numbers['F']:g}; accepted: a number > 0")
            self._feed = numbers["F"] * self._unit
        if any(axis in numbers for axis in "XYZ") or (motion and "I" in numbers):
            self._move(number, numbers)

    def _code(self, number: int, code: float, words: list[tuple[str, float]]) -> bool:
        """Take a G word; return whether it is a motion."""
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
        elif code not in _WITHOUT_MOTION:
            self._refuse(number, f"G{code:g}; accepted: G0 to G3, G17, G20, G21, G90, G91, G90.1, G91.1")
        return False

    def _move(self, number: int, numbers: dict[str, float]) -> None:
        given = {k: numbers[axis] * self._unit for k, axis in enumerate("XYZ") if axis in numbers}
        if self._mode is None:
            self._refuse(number, "moves without G0, G1, G2 or G3; accepted: with one of them")
        base = np.zeros(3) if self._at is None else self._at
        end = base.copy()
        for k, value in given.items():
            end[k] = value + (base[k] if self._relative else 0.0)
        before, self._at = self._at, end
        if not self._segments and (before is None or self._mode == 0.0):
            if self._mode in (2.0, 3.0):
                self._refuse(number, "an arc from nowhere; accepted: after a G0 or G1")
            self._start = end
            return
        assert before is not None
        speed = None if self._mode == 0.0 else self._speed()
        if self._mode in (0.0, 1.0):
            if np.any(end != before):
                self._segments.append(Segment((tuple(end.tolist()),), speed=speed))
            return
        if end[2] != before[2] or numbers.get("K"):
            self._refuse(number, "an arc that leaves the plane G17; accepted: X, Y, I and J")
        normal = (0.0, 0.0, 1.0 if self._mode == 3.0 else -1.0)
        center = self._center(number, before, end, numbers)
        near, far = np.linalg.norm(before - center), np.linalg.norm(end - center)
        if near == 0.0 or abs(near - far) > 0.02:
            self._refuse(number, f"the arc's ends are {near:.6g} and {far:.6g} mm from its centre; accepted: as far")
        self._segments.append(Segment((tuple(end.tolist()),), "arc", tuple(center.tolist()), normal, speed=speed))

    def _speed(self) -> float | None:
        """Return F in m/s."""
        return None if self._feed is None else self._feed * UNITS["mm"] / 60.0

    def _center(self, number: int, start: Array, end: Array, numbers: dict[str, float]) -> Array:
        if "R" in numbers:
            chord, radius = end - start, numbers["R"] * self._unit
            half = 0.5 * float(np.linalg.norm(chord))
            if half == 0.0 or abs(radius) < half * (1.0 - 1e-4):
                self._refuse(number, f"R{numbers['R']:g} between ends {2.0 * half:g} mm apart; accepted: half of that, "
                             "or more, between different ends")  # fmt: skip
            height = math.sqrt(max(radius * radius - half * half, 0.0))
            across = np.array([-chord[1], chord[0], 0.0]) / (2.0 * half)
            left = (self._mode == 3.0) == (radius > 0.0)
            return np.asarray(0.5 * (start + end) + (height if left else -height) * across)
        if "I" not in numbers and "J" not in numbers:
            self._refuse(number, "an arc without a centre; accepted: with I and J, or with R")
        offset = np.array([numbers.get("I", 0.0), numbers.get("J", 0.0), 0.0]) * self._unit
        if self._relative_center:
            return np.asarray(start + offset)
        if not {"I", "J"} <= numbers.keys():
            self._refuse(number, "an arc whose centre is absolute (G90.1) has I or J alone; accepted: both")
        return np.asarray(offset + np.array([0.0, 0.0, start[2]]))
