"""`rx90 bag plot`: what is drawn without options, of chosen topics and joints, and of two bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from processes import files_up_to

from rx90_common.bags.charts import topic_figures
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.plotting import plot_bags
from rx90_common.bags.writing import write_joint_states
from rx90_common.report.picture import picture
from rx90_emulator.cli.frame import run

pytestmark = pytest.mark.slow

NAMES = ("joint_1", "joint_2")
STAMPS = np.arange(0, 400_000_000, 1_000_000)
TIME = STAMPS / 1e9
POSITION = np.column_stack([np.sin(20.0 * TIME), np.cos(20.0 * TIME)])


def series(topic: str, shift: float = 0.0, start: int = 0) -> JointSeries:
    """Return positions and torques of two joints; those of the second are `shift` higher."""
    return JointSeries(topic, NAMES, STAMPS + start, position=POSITION + np.array([0.0, shift]), effort=30.0 * POSITION)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return bags by name: `first`, `second` in which joint_2 is 0.25 rad off, `later`, `walls` of a wall clock."""
    folder = tmp_path_factory.mktemp("bags")
    content = {
        "first": [series("/joint_states"), series("/friction_states"), series("/extra")],
        "second": [series("/joint_states", 0.25), series("/friction_states")],
        "later": [series("/joint_states", start=10**12)],
        "walls": [series("/joint_states", start=1_790_000_000 * 10**9)],
    }
    for name, what in content.items():
        write_joint_states(folder / name, what)
    return {name: folder / name for name in content}


def test_an_error_s_effort_is_the_commanded_torque(tmp_path: Path) -> None:
    """Beside the errors of position and velocity the controller's topic holds no error, but a torque."""
    write_joint_states(tmp_path / "bag", [series("/cell/rx90_controller/tracking_error")])
    (plot,) = plot_bags([tmp_path / "bag"])
    assert [panel.label for panel in plot.panels] == ["position, rad", "commanded torque, Nm"]


def test_without_options_the_usual_topics_are_drawn(bags: dict[str, Path]) -> None:
    """Joint states, then friction, by what they hold, with units; other topics, and chosen joints, where asked for."""
    joints, friction = plot_bags([bags["first"]])
    assert (joints.panels[0].title, friction.panels[0].title) == ("/joint_states", "/friction_states")
    assert [panel.label for panel in joints.panels] == ["position, rad", "effort, Nm"]
    assert [panel.label for panel in friction.panels] == ["bristle deflection, rad", "friction torque, Nm"]
    positions, efforts = topic_figures(joints)
    assert efforts.xaxis.axis_label.text == "time, s"
    assert [line.name for line in positions.renderers] == list(NAMES)
    second = efforts.renderers[1].data_source.data
    assert np.array_equal(second["y"], 30.0 * POSITION[:, 1])
    assert np.array_equal(second["x"], TIME)
    (extra,) = plot_bags([bags["first"]], topics=["extra"], joints=["joint_2"])  # what is asked for, alone
    assert [line.name for line in extra.panels[0].lines] == ["joint_2"]
    (walls,) = plot_bags([bags["walls"]])  # from 0 on, and when that was
    assert np.array_equal(walls.panels[0].lines[0].time, TIME)
    assert walls.time_label == "time since 1790000000.000000000 s, s"


def test_two_bags_are_drawn_with_their_difference(bags: dict[str, Path]) -> None:
    """Both lie over each other, below is the second less the first."""
    both, difference = plot_bags([bags["first"], bags["second"]])[0].panels[:2]
    assert [line.name for line in both.lines] == [
        "joint_1, first", "joint_2, first", "joint_1, second", "joint_2, second",
    ]  # fmt: skip
    assert difference.title == "second less first"
    assert not difference.lines[0].values.any()
    assert np.allclose(difference.lines[1].values, 0.25)
    moved = plot_bags([bags["first"], bags["later"]], align="start")[0]
    assert not moved.panels[1].lines[1].values.any()


def test_one_command_makes_a_page_or_a_picture(
    bags: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    check_report: Callable[[Path], None],
) -> None:
    """Without an option a page of the bag's name; a picture by the suffix; the page is as every report must be."""
    monkeypatch.chdir(tmp_path)
    assert run("rx90 bag", ["plot", str(bags["first"]), str(bags["second"])]) == 0
    assert capsys.readouterr().out == f"plot: {tmp_path / 'first.html'}\n"
    assert "second against first" in (tmp_path / "first.html").read_text(encoding="utf-8")
    assert run("rx90 bag", ["plot", str(bags["first"]), "--output", "one.png", "--joints", "joint_1"]) == 0
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    check_report(tmp_path / "first.html")


def test_a_full_disk_leaves_the_old_page_or_picture(
    bags: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What cannot be written to its end, here by a limit of the size of files, does not stay; an old file does."""
    with picture(tmp_path / "a.png") as figure:  # with what matplotlib keeps on the disk
        figure.subplots().plot(TIME, TIME)
    old = {name: f"old {name}".encode() for name in ("a.html", "a.png")}
    for name, content in old.items():
        (tmp_path / name).write_bytes(content)
    for name in (*old, "new.html"):
        with files_up_to(1000):
            assert run("rx90 bag", ["plot", str(bags["first"]), "--output", str(tmp_path / name), "--force"]) == 3
        assert f"{name}: cannot be written (File too large)" in capsys.readouterr().err
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == old
