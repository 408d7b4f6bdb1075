"""Paths from CSV and DXF: against points by hand and ezdxf's own geometry."""

import math
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from rx90_common.base.errors import ConfigError, Rx90Error, Rx90Warning
from rx90_controller.paths.path import Path
from rx90_emulator.loop.drawing import Drawing
from rx90_emulator.loop.path_file import load_path


def _read(folder: File, name: str, text: str, **more: Any) -> Path:
    file = folder / name
    file.write_text(text)
    return Path(*Drawing(name=str(file), **more).read())


def test_a_drawing_is_laid_where_its_origin_and_axes_are(tmp_path: File, drawing: Any) -> None:
    """A quarter turn about z and a shift: x becomes y; arcs keep their sense, and a rounded corner its zone."""
    space = drawing.modelspace()
    space.add_arc((0.0, 0.0), 10.0, 0.0, 90.0)
    space.add_line((0.0, 10.0), (-20.0, 10.0))
    place = {"origin": (0.5, 0.1, 0.2), "rpy_degrees": (0.0, 0.0, 90.0)}
    turned = _dxf(tmp_path, drawing, zone=0.002, **place)
    ends = turned.curve.at(np.array([0.0, turned.length]))
    np.testing.assert_allclose(ends, [(0.5, 0.11, 0.2), (0.49, 0.08, 0.2)], atol=1e-9)
    assert turned.stops == (0.0, turned.length), "the arc goes over into the line"
    space.add_line((-20.0, 10.0), (-20.0, 13.0))
    corner = _dxf(tmp_path, drawing, zone=0.002, **place)
    assert corner.segments[1].zone == pytest.approx(0.0015), "half of the shorter neighbour"
    assert len(corner.stops) == 2


CSV = {
    "with names and units": "x [mm]; y [mm]; z [mm]; note\n600; 0; 200; a\n600; 50; 200; b\n620; 90; 210; c\n",
    "in other columns": "t,z [m],x [m],y [m]\n0,0.2,0.6,0\n1,0.2,0.6,0.05\n2,0.21,0.62,0.09\n",
    "bare": "# seam\n0.6 0 0.2\n0.6  0.05 0.2\n\n0.62 0.09 0.21\n",
}


@pytest.mark.parametrize("name", CSV)
def test_points_of_a_table(tmp_path: File, name: str) -> None:
    """Three points in SI units, whatever the table looks like; on a spline, or as corners of lines."""
    wanted = ((0.6, 0.0, 0.2), (0.6, 0.05, 0.2), (0.62, 0.09, 0.21))
    unit = {"unit": "m"} if name == "bare" else {}
    path = _read(tmp_path, "seam.csv", CSV[name], **unit)
    assert path.segments[0].kind == "spline"
    np.testing.assert_allclose([path.start, *path.segments[0].points], wanted)
    lines = _read(tmp_path, "seam.csv", CSV[name], points="lines", **unit)
    np.testing.assert_allclose([lines.start, *(one.points[0] for one in lines.segments)], wanted)


REFUSED = {
    "no unit": ("p.csv", "1 2 3\n4 5 6\n", {}, "names no unit; accepted: with unit, one of m, mm"),
    "another unit": ("p.csv", "x [mm],y [mm],z [mm]\n1,2,3\n4,5,6\n", {"unit": "m"}, "is in mm, unit is m"),
    "an unknown unit": ("p.csv", "x [ft],y [ft],z [ft]\n1,2,3\n4,5,6\n", {"unit": "m"}, "units ft, ft, ft; accepted"),
    "two units": ("p.csv", "x [mm],y [m],z [mm]\n1,2,3\n4,5,6\n", {"unit": "m"}, "units mm, m, mm; accepted: one of"),
    "a gap": ("p.csv", "x [m],y [m],z [m]\n1,2,3\n4,,6\n", {}, "line 3 is '4, , 6'; accepted: finite numbers, x, y, z"),
    "not a number": ("p.csv", "# a\n\n1 2 nan\n", {"unit": "m"}, "line 3 is '1, 2, nan'"),
    "a column too much": ("p.csv", "1 2 3 4\n", {"unit": "m"}, "line 1 is '1, 2, 3, 4'; accepted"),
    "a stray quotation mark": ("p.csv", 'x,y,z\n"1,2,3' + "\n1,2,3" * 30_000, {"unit": "m"}, "line 2 is '1,2,3'"),
    "twice": ("p.csv", "1 2 3\n1 2 3\n", {"unit": "m"}, r"starts and ends at \(1, 2, 3\) m"),
    "one point": ("p.csv", "1 2 3\n", {"unit": "m"}, "holds 1 point; accepted: two or more"),
    "another kind": ("p.svg", "", {}, "ends with '.svg'; accepted: .csv, .dxf"),
    "a layer": ("p.csv", "1 2 3\n", {"layer": "a"}, "layer of a file without layers"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_refused_with_its_line(tmp_path: File, name: str) -> None:
    """Each refusal is one line with file, line, what is there and what is accepted."""
    file, text, more, said = REFUSED[name]
    with pytest.raises(Rx90Error, match=said) as refusal:
        _read(tmp_path, file, text, **more)
    assert "\n" not in str(refusal.value)


def test_a_path_file_names_its_drawing(tmp_path: File) -> None:
    """The file beside it is read, with its origin; a start beside a file is refused."""
    (tmp_path / "part.csv").write_text("x [mm],y [mm],z [mm]\n0,0,0\n50,0,0\n")
    head = "path:\n  file: {name: part.csv, origin: [0.6, 0, 0.2]}\n  speed: 0.2\n  acceleration: 1.0\n"
    (tmp_path / "path.yaml").write_text(f"{head}  tool_rpy_degrees: [0, 180, 0]\n")
    path = load_path(tmp_path / "path.yaml")
    assert path.start == (0.6, 0.0, 0.2)
    assert path.length == pytest.approx(0.05)
    (tmp_path / "both.yaml").write_text(f"{head}  tool_rpy_degrees: [0, 180, 0]\n  start: [0, 0, 0]\n")
    with pytest.raises(Rx90Error, match=r"path.start is \[0.0, 0.0, 0.0\]; accepted: none beside a file"):
        load_path(tmp_path / "both.yaml")


@pytest.fixture
def drawing() -> Any:
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new()
    document.header["$INSUNITS"] = 4
    return document


def _dxf(folder: File, document: Any, **more: Any) -> Path:
    document.saveas(folder / "part.dxf")
    return Path(*Drawing(name=str(folder / "part.dxf"), **more).read())


def test_dxf_entities_are_joined_in_their_order(tmp_path: File, drawing: Any) -> None:
    """Lines, arcs, polylines with bulges and a spline, some drawn backwards: ezdxf's own points lie on the path."""
    import ezdxf.path

    space = drawing.modelspace()
    space.add_arc((100.0, 10.0), 10.0, 270.0, 0.0)  # from (100, 0) to (110, 10)
    space.add_line((100.0, 0.0), (50.0, 0.0))  # backwards
    space.add_lwpolyline([(110.0, 10.0, 0.0), (110.0, 30.0, -0.5), (140.0, 40.0, 0.0)], format="xyb")
    space.add_arc((140.0, 50.0, 0.0), 10.0, 270.0, 0.0, dxfattribs={"extrusion": (0, 0, 1)})
    space.add_spline([(180.0, 60.0, 5.0), (165.0, 55.0, 3.0), (150.0, 50.0, 0.0)])
    space.add_text("seam")
    path = _dxf(tmp_path, drawing)
    wanted = [point for entity in space if entity.dxftype() != "TEXT"
              for point in ezdxf.path.make_path(entity).flattening(1e-4)]  # fmt: skip
    off = path.error(np.array([tuple(point) for point in wanted]) * 1e-3)
    assert off.perpendicular.max() < 5e-6
    assert off.along.max() == pytest.approx(path.length, abs=1e-6)
    assert path.start == pytest.approx((0.05, 0.0, 0.0))


SPLINES = {
    "a corner at a knot of full multiplicity, and uneven knots": (
        [(0, 0, 0), (33, 0, 0), (66, 0, 0), (100, 0, 0), (100, 20, 0), (100, 40, 0), (100, 60, 0)],
        3, [0, 0, 0, 0, 1, 1, 1, 61, 61, 61, 61], None, 1,
    ),
    "a corner of three equal control points": (
        [(0, 0, 0), (30, 0, 5), (60, 10, 0), (60, 10, 0), (60, 10, 0), (60, 40, 0), (20, 60, 0)],
        3, [0, 0, 0, 0, 1, 2, 3, 4, 4, 4, 4], None, 1,
    ),
    "uneven knots": (
        [(0, 0, 0), (5, 40, 0), (10, -40, 0), (15, 40, 0), (200, 0, 0), (250, 50, 0), (334, 0, 0)],
        3, [0, 0, 0, 0, 0.01, 0.02, 50, 50.5, 50.5, 50.5, 50.5], None, 0,
    ),
    "weights": ([(0, 0, 0), (50, 0, 0), (50, 50, 0), (100, 50, 0)], 3, [0, 0, 0, 0, 1, 1, 1, 1], [1, 40, 40, 1], 0),
    "a cusp": ([(0, 0, 0), (100, 100, 0), (0, 100, 0), (100, 0, 0)], 3, [0, 0, 0, 0, 1, 1, 1, 1], None, 0),
    "a closed one with a corner where it begins": (
        [(0, 0, 0), (60, 50, 0), (60, -50, 0), (0, 0, 0)], 3, [0, 0, 0, 0, 1, 1, 1, 1], None, 0,
    ),
    "a closed one, and smooth": (
        [(0, 0, 0), (0, 20, 0), (40, 40, 0), (60, 0, 0), (40, -40, 0), (0, -20, 0), (0, 0, 0)],
        3, [0, 0, 0, 0, 1, 2, 3, 4, 4, 4, 4], None, 0,
    ),
    "knots before its begin and behind its end": (
        [(0, 0, 0), (20, 40, 0), (60, -20, 0), (100, 10, 0), (120, 0, 0)], 3, [0, 1, 2, 3, 4, 5, 6, 7, 8], None, 0,
    ),
    "a polygon": ([(0, 0, 0), (50, 0, 0), (50, 50, 0), (90, 70, 0)], 1, [0, 0, 1, 5, 6, 6], None, 2),
}  # fmt: skip


@pytest.mark.parametrize("name", SPLINES)
def test_dxf_splines_are_kept_within_the_tolerance(tmp_path: File, drawing: Any, name: str) -> None:
    """By SciPy's B-splines: the path is nowhere farther than 10 µm from one, and has its corners."""
    control, degree, knots, weights, corners = SPLINES[name]
    space = drawing.modelspace()
    if weights is None:
        space.add_open_spline(control, degree)
        space[0].knots = knots
    else:
        space.add_rational_spline(control, weights, degree)
        space[0].knots = knots
    path = _dxf(tmp_path, drawing)
    share = np.ones(len(control)) if weights is None else np.array(weights, dtype=np.float64)
    homogeneous = np.column_stack([np.array(control) * share[:, None], share])
    curve = BSpline(np.array(knots, dtype=np.float64), homogeneous, degree)
    spans = np.unique(knots[degree : len(control) + 1])
    at = np.concatenate([np.linspace(a, b, 1001)[:-1] for a, b in pairwise(spans)])
    values = curve(np.append(at, np.nextafter(spans[-1], 0.0)))
    places = 1e-3 * values[:, :3] / values[:, 3:]
    on_path = path.curve.at(np.linspace(0.0, path.length, 50_000))
    step = path.length / 50_000
    assert cKDTree(on_path).query(places)[0].max() <= math.hypot(1e-5, step)
    gap = 0.5 * np.linalg.norm(np.diff(places, axis=0), axis=1).max()
    assert cKDTree(places).query(on_path[::20])[0].max() <= math.hypot(1e-5, gap)
    assert path.length == pytest.approx(np.linalg.norm(np.diff(places, axis=0), axis=1).sum(), rel=1e-3)
    assert len(path.stops) == 2 + corners


def test_dxf_spline_that_takes_too_many_points_is_refused(tmp_path: File, drawing: Any) -> None:
    """Within 10 µm of a spline of some 100 km in each span no path is made."""
    control = 1e8 * np.random.default_rng(1).normal(size=(900, 3))
    drawing.modelspace().add_open_spline(control.tolist(), 3)
    with pytest.raises(ConfigError, match=r"do not keep the curve within 1e-05 m of it; accepted: a spline that"):
        _dxf(tmp_path, drawing)


UNITS_OF_DRAWINGS = {
    "no header": ("", ""),
    "a header without a unit": ("  0\nSECTION\n  2\nHEADER\n  9\n$ACADVER\n  1\nAC1009\n  0\nENDSEC\n", ""),
    "no header, but a comment": ("999\n$INSUNITS\n", ""),
    "feet": ("  0\nSECTION\n  2\nHEADER\n  9\n$INSUNITS\n 70\n     2\n  0\nENDSEC\n", "is in Feet; read in mm"),
    "centimetres": ("  0\nSECTION\n  2\nHEADER\n  9\n$INSUNITS\n 70\n     5\n  0\nENDSEC\n", "is in cm; read in mm"),
}


@pytest.mark.parametrize("name", UNITS_OF_DRAWINGS)
def test_the_unit_of_the_path_goes_before_that_of_a_drawing(tmp_path: File, name: str) -> None:
    """A unit missing in the drawing is the path's; a wrong one is, too, with a warning; without any it is refused."""
    pytest.importorskip("ezdxf")
    head, said = UNITS_OF_DRAWINGS[name]
    text = "  0\nTEXT\n  8\n0\n 10\n0\n 20\n0\n 40\n1\n  1\n$INSUNITS\n"
    line = "  0\nLINE\n  8\n0\n 10\n0\n 20\n0\n 11\n40\n 21\n0\n  0\nENDSEC\n  0\nEOF\n"
    line = f"  0\nSECTION\n  2\nENTITIES\n{text}{line}"
    with pytest.warns(Rx90Warning, match=rf"part\.dxf: {said}") if said else nullcontext():
        path = _read(tmp_path, "part.dxf", head + line, unit="mm")
    assert path.length == pytest.approx(0.04)
    if name == "centimetres":
        assert _read(tmp_path, "part.dxf", head + line, unit="cm").length == pytest.approx(0.4)
        assert _read(tmp_path, "part.dxf", head + line).length == pytest.approx(0.4)
    else:
        said = said.partition(";")[0] or "names no unit"
        with pytest.raises(ConfigError, match=rf"{said}; accepted: with unit, one of m, mm"):
            _read(tmp_path, "part.dxf", head + line)


def test_dxf_circles_layers_and_mirrored_arcs(tmp_path: File, drawing: Any) -> None:
    """A circle is closed; a layer leaves out others; an arc seen from below starts and ends where ezdxf says."""
    space = drawing.modelspace()
    space.add_circle((50.0, 20.0), 15.0, dxfattribs={"layer": "cut"})
    arc = space.add_arc((0.0, 0.0), 10.0, 0.0, 90.0, dxfattribs={"layer": "mirrored", "extrusion": (0, 0, -1)})
    assert _dxf(tmp_path, drawing, layer="cut").length == pytest.approx(2 * math.pi * 0.015)
    mirrored = _dxf(tmp_path, drawing, layer="mirrored")
    ends = mirrored.curve.at(np.array([0.0, mirrored.length]))
    np.testing.assert_allclose(ends, np.array([tuple(arc.start_point), tuple(arc.end_point)]) * 1e-3, atol=1e-9)
    assert mirrored.length == pytest.approx(math.pi / 2 * 0.01)
    with pytest.raises(ConfigError, match=r"is one path from .*, and 1 entities beside it; accepted"):
        _dxf(tmp_path, drawing)
    with pytest.raises(ConfigError, match=r"holds no path on its layer; accepted: .* on cut, mirrored"):
        _dxf(tmp_path, drawing, layer="none")


def test_dxf_branches_and_gaps_are_refused(tmp_path: File, drawing: Any) -> None:
    """Three ends in one place, or a gap of 0.1 mm, are refused with the place; ends 10 nm apart are one."""
    space = drawing.modelspace()
    space.add_line((0.0, 0.0), (50.0, 0.0))
    follower = space.add_line((50.00001, 0.0), (90.0, 10.0))
    assert len(_dxf(tmp_path, drawing).segments) == 2
    branch = space.add_line((50.0, 0.0), (50.0, 40.0))
    said = r"is one path from \(0\.0, .* to \(50\.0, 0\.0, 0\.0\), and {} entities beside it; accepted: one path"
    with pytest.raises(ConfigError, match=said.format(2)):
        _dxf(tmp_path, drawing)
    space.delete_entity(branch)
    follower.dxf.start = (50.1, 0.0)
    with pytest.raises(ConfigError, match=said.format(1)):
        _dxf(tmp_path, drawing)


def test_dxf_loops_begin_where_the_first_entity_does(tmp_path: File, drawing: Any) -> None:
    """Two lines and an arc around a corner, drawn in any direction: round once, from the first one's start."""
    space = drawing.modelspace()
    space.add_line((10.0, 0.0), (0.0, 0.0))
    space.add_line((0.0, 10.0), (0.0, 0.0))
    space.add_arc((0.0, 0.0), 10.0, 0.0, 90.0)
    path = _dxf(tmp_path, drawing)
    assert path.start == pytest.approx((0.01, 0.0, 0.0))
    ends = [segment.points[-1] for segment in path.segments]
    np.testing.assert_allclose(ends, [(0.0, 0.0, 0.0), (0.0, 0.01, 0.0), (0.01, 0.0, 0.0)], atol=1e-12)
    assert path.length == pytest.approx(0.02 + math.pi / 2 * 0.01)


NO_DRAWINGS = {
    "an unknown table": "0\nSECTION\n2\nTABLES\n0\nTABLE\n2\nDWGMGR\n70\n1\n0\nENDTAB\n0\nENDSEC\n0\nEOF\n",
    "a number without end": (
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSUNITS\n70\n1e400\n0\nENDSEC\n0\nEOF\n"
    ),
    "a spline without points": (
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1015\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n0\n"
        "SPLINE\n5\n1F\n100\nAcDbEntity\n8\n0\n100\nAcDbSpline\n71\n3\n0\nENDSEC\n0\nEOF\n"
    ),
    "empty": "",
    "cut": "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSBASE\n10\n0\n",
    "binary and cut": "AutoCAD Binary DXF\r\n\x1a\0",
}


@pytest.mark.parametrize("text", NO_DRAWINGS.values(), ids=NO_DRAWINGS)
def test_dxf_that_is_none_is_one_line(tmp_path: File, text: str) -> None:
    """Text that is no drawing, and drawings that ezdxf stumbles over, are refused in one line."""
    pytest.importorskip("ezdxf")
    with pytest.raises(ConfigError, match=r"cannot be read|ends within its header") as refusal:
        _read(tmp_path, "part.dxf", text)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "part", "count"), [("a.csv", "0,0,0\n", 500_001), ("a.csv", "1", 70_000), ("a.dxf", "x", 1 + (8 << 20))]
)
def test_a_file_that_would_take_the_memory_is_refused_unread(tmp_path: File, name: str, part: str, count: int) -> None:
    """By its bytes, its lines, and the characters of one."""
    if name.endswith(".dxf"):
        pytest.importorskip("ezdxf")
    (tmp_path / name).write_text(part * count)
    with pytest.raises(Rx90Error, match=r"(holds|larger) .*; accepted: up to"):
        Drawing(name=str(tmp_path / name), unit="mm").read()


NO_SPLINES = {
    "knots fall": ([0, 0, 0, 0, 1, 1, 1, 0.5], [1, 1, 1, 1], 1.0, "with the knots .* accepted: finite numbers"),
    "no knot": ([0, 0, 0, 0, math.nan, 1, 1, 1], [1, 1, 1, 1], 1.0, "with the knots .* accepted: finite numbers"),
    "no place": ([0, 0, 0, 0, 1, 1, 1, 1], [1, 1, 1, 1], math.inf, "with a point that is no place"),
    "no length": ([0, 0, 0, 0, 1, 1, 1, 1], [1, 1, 1, 1], 0.0, "holds no path"),
}


@pytest.mark.parametrize("name", NO_SPLINES)
def test_dxf_spline_that_is_none_is_one_line(tmp_path: File, drawing: Any, name: str) -> None:
    """Knots, weights and points that make no curve are refused with them, not drawn as another curve."""
    knots, weights, size, said = NO_SPLINES[name]
    control = [(0, 0, 0), (20 * size, 40 * size, 0), (60 * size, 0, 0), (90 * size, 0, 0)]
    drawing.modelspace().add_rational_spline([(0, 0, 0)] * 4, weights, 3)
    spline = drawing.modelspace()[0]
    spline.control_points = control
    spline.knots = knots
    with pytest.raises(ConfigError, match=said) as refusal:
        _dxf(tmp_path, drawing)
    assert "\n" not in str(refusal.value)
