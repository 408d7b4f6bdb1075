"""`rx90 bag plot`: what is drawn without options, of chosen topics and joints, and of two bags."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from bokeh.plotting import figure
from processes import files_up_to

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.plotting import plot_bags
from rx90_common.bags.writing import write_joint_states
from rx90_emulator.cli.frame import run

pytestmark = pytest.mark.slow

NAMES = ("joint_1", "joint_2")
STAMPS = np.arange(0, 400_000_000, 1_000_000)
TIME = STAMPS / 1e9
POSITION = np.column_stack([np.sin(20.0 * TIME), np.cos(20.0 * TIME)])


def series(topic: str, shift: float = 0.0, start: int = 0) -> JointSeries:
    return JointSeries(topic, NAMES, STAMPS + start, position=POSITION + np.array([0.0, shift]), effort=30.0 * POSITION)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
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


def labels(figures: Sequence[figure]) -> list[str]:
    return [shown.yaxis.axis_label.text for shown in figures]


def names(shown: figure) -> list[str]:
    return [line.name for line in shown.renderers]


def test_an_error_s_effort_is_the_commanded_torque(tmp_path: Path) -> None:
    """Beside the errors of position and velocity the controller's topic holds no error, but a torque."""
    topic = "/cell/rx90_controller/tracking_error"
    write_joint_states(tmp_path / "bag", [series(topic)])
    assert labels(plot_bags([tmp_path / "bag"], [topic])[topic]) == ["position, rad", "commanded torque, Nm"]


def test_without_options_the_usual_topics_are_drawn(bags: dict[str, Path]) -> None:
    """Joint states, then friction, by what they hold, with units; other topics, and chosen joints, where asked for."""
    topics = plot_bags([bags["first"]])
    assert set(topics) == {"/joint_states", "/friction_states"}
    assert labels(topics["/friction_states"]) == ["bristle deflection, rad", "friction torque, Nm"]
    positions, efforts = topics["/joint_states"]
    assert labels([positions, efforts]) == ["position, rad", "effort, Nm"]
    assert efforts.xaxis.axis_label.text == "time, s"
    assert names(positions) == list(NAMES)
    second = efforts.renderers[1].data_source.data
    assert np.array_equal(second["y"], 30.0 * POSITION[:, 1])
    assert np.array_equal(second["x"], TIME)
    extra = plot_bags([bags["first"]], topics=["extra"], joints=["joint_2"])  # what is asked for, alone
    assert names(extra["/extra"][0]) == ["joint_2"]
    walls = plot_bags([bags["walls"]])["/joint_states"][-1]  # from 0 on, and when that was
    assert np.array_equal(walls.renderers[0].data_source.data["x"], TIME)
    assert walls.xaxis.axis_label.text == "time since 1790000000.000000000 s, s"


def test_two_bags_are_drawn_over_each_other(bags: dict[str, Path]) -> None:
    """The lines of the second lie over those of the first, moved to its start where that is asked for."""
    positions, efforts = plot_bags([bags["first"], bags["second"]])["/joint_states"]
    assert names(positions) == ["joint_1, first", "joint_2, first", "joint_1, second", "joint_2, second"]
    values = [line.data_source.data["y"] for line in positions.renderers]
    assert np.allclose(values[3] - values[1], 0.25)
    assert names(efforts) == names(positions)
    moved = plot_bags([bags["first"], bags["later"]], align="start")["/joint_states"][0]
    assert np.array_equal(moved.renderers[3].data_source.data["x"], TIME)


def test_one_command_makes_a_page(
    bags: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    check_report: Callable[[Path], None],
) -> None:
    """Without an option a page of the bag's name, as every report must be; where the disk is full the old one stays."""
    monkeypatch.chdir(tmp_path)
    words = ["plot", str(bags["first"]), str(bags["second"])]
    assert run("rx90 bag", words) == 0
    page = tmp_path / "first.html"
    assert capsys.readouterr().out == f"plot: {page}\n"
    text = page.read_text(encoding="utf-8")
    assert "second against first" in text
    check_report(page)
    with files_up_to(1000):
        assert run("rx90 bag", [*words, "--force"]) == 3
    assert "first.html: cannot be written (File too large)" in capsys.readouterr().err
    assert page.read_text(encoding="utf-8") == text
    assert run("rx90 bag", [*words, "--output", "one.png"]) == 2
