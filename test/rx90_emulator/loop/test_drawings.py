"""Paths from CSV and DXF: against points by hand and ezdxf's own geometry."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest

from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_controller.paths.path import Path
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.drawing import Drawing
from rx90_emulator.loop.path_file import load_path


def _read(folder: File, name: str, text: str, **more: Any) -> Path:
    file = folder / name
    file.write_text(text)
    return Path(*Drawing(file, **more).read())


def test_a_drawing_is_laid_where_its_origin_and_axes_are(tmp_path: File, drawing: Any) -> None:
    """A quarter turn about z and a shift: x becomes y; arcs keep their sense, and a rounded corner its zone."""
    space = drawing.modelspace()
    space.add_arc((0.0, 0.0), 10.0, 0.0, 90.0)
    space.add_line((0.0, 10.0), (-20.0, 10.0))
    place = {"origin": (0.5, 0.1, 0.2), "rpy": (0.0, 0.0, math.pi / 2)}
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
    "two units": ("p.csv", "x [mm],y [mm],z [mm]\n1,2,3\n4,5,6\n", {"unit": "m"}, "is in mm, unit is m"),
    "a gap": ("p.csv", "x [m],y [m],z [m]\n1,2,3\n4,,6\n", {}, "line 3 is '4, , 6'; accepted: finite numbers, x, y, z"),
    "not a number": ("p.csv", "1 2 nan\n", {"unit": "m"}, "line 1 is '1, 2, nan'"),
    "twice": ("p.csv", "1 2 3\n1 2 3\n", {"unit": "m"}, r"points 1 and 2 are both \(1.0, 2.0, 3.0\)"),
    "one point": ("p.csv", "1 2 3\n", {"unit": "m"}, "holds 1 point; accepted: two or more"),
    "another kind": ("p.svg", "", {}, "ends with '.svg'; accepted: .csv, .dxf"),
    "a layer": ("p.csv", "1 2 3\n", {"layer": "a"}, "layer of a file without layers"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_refused_with_its_line(tmp_path: File, name: str) -> None:
    """Each refusal is one line with file, line, what is there and what is accepted."""
    file, text, more, said = REFUSED[name]
    with pytest.raises(ConfigError, match=said) as refusal:
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
    with pytest.raises(Rx90Error, match="a start beside a file"):
        load_path(tmp_path / "both.yaml")


class Missing:
    """An importer that finds no ezdxf."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:  # noqa: ARG002
        """Refuse it."""
        if name == "ezdxf":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def test_dxf_without_its_package_is_one_line(
    tmp_path: File, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where ezdxf is missing a command says in one line what to install."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "ezdxf"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    (tmp_path / "part.dxf").write_text("")
    (tmp_path / "path.yaml").write_text("path: {file: {name: part.dxf}, speed: 0.1, acceleration: 1.0, "
                                        "tool_rpy_degrees: [0, 180, 0]}\n")  # fmt: skip
    assert run("rx90_path", [str(tmp_path / "path.yaml"), "--dry-run"]) == 3
    assert re.fullmatch(r"rx90_path: .*ezdxf.*pip install.*\n", capsys.readouterr().err)


@pytest.fixture
def drawing() -> Any:
    """Return a new drawing in mm."""
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new()
    document.header["$INSUNITS"] = 4
    return document


def _dxf(folder: File, document: Any, **more: Any) -> Path:
    document.saveas(folder / "part.dxf")
    return Path(*Drawing(folder / "part.dxf", **more).read())


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
    with pytest.raises(ConfigError, match=r"on the layer 'none' \(there are cut, mirrored\)"):
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


@pytest.mark.parametrize(
    "text",
    [
        "hello\nworld\n",
        "0\nSECTION\n2\nTABLES\n0\nTABLE\n2\nDWGMGR\n70\n1\n0\nENDTAB\n0\nENDSEC\n0\nEOF\n",
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSUNITS\n70\n1e400\n0\nENDSEC\n0\nEOF\n",
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1015\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n0\n"
        "SPLINE\n5\n1F\n100\nAcDbEntity\n8\n0\n100\nAcDbSpline\n71\n3\n0\nENDSEC\n0\nEOF\n",
    ],
    ids=["text", "an unknown table", "a number without end", "a spline without points"],
)
def test_dxf_that_is_none_is_one_line(tmp_path: File, text: str) -> None:
    """Text that is no drawing, and drawings that ezdxf stumbles over, are refused in one line."""
    pytest.importorskip("ezdxf")
    with pytest.raises(ConfigError, match="cannot be read") as refusal:
        _read(tmp_path, "part.dxf", text)
    assert "\n" not in str(refusal.value)
