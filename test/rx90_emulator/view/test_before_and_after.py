"""What a user keeps of the live page: a run to compare with, plots as files, a bag; in a real browser."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import BrowserPage, served
from PIL import Image

from rx90_common.report.plot import Curve, Panel
from rx90_emulator.view.page import Page
from rx90_emulator.view.plots import RollingPlot, RunComparison, add_plot_export, table
from rx90_emulator.view.scene import LineScene

START, END = np.array([0.5, 0.0, 0.2]), np.array([0.7, 0.0, 0.2])
SHARE = np.linspace(0.0, 1.0, 401)
ALONG = "path error along the line [mm]"
UNITS = "torque [Nm]"


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """Serve a page on any free port, which writes beneath a new folder."""
    with served(Page("test", port=0, output=tmp_path)) as page:
        yield page


def run(line: LineScene, begin: float, largest: float) -> None:
    """Lead the tip along the line within 4 s, half a sine beside it, `largest` m in the middle."""
    times = begin + 4.0 * SHARE
    line.meter.follow(times[[0, -1]], np.stack([START, END]), np.array([True, True]))
    line.add(times, START + SHARE[:, None] * (END - START) + np.outer(largest * np.sin(np.pi * SHARE), [0, 1.0, 0]))


def test_two_runs_are_compared_along_the_line(page: Page, open_page: Callable[..., BrowserPage]) -> None:
    """The run that is held stays while others come: curves, largest, place, RMS and ratio; another line lets it go."""
    line, runs = LineScene(page, "/line", START, END), RunComparison(page)
    page.every(0.05, lambda _: runs.draw(line))
    shown = open_page(page.address, (1000, 700))
    hold, release = (shown.page.get_by_role("button", name=words) for words in ("Hold the", "Let the held"))
    assert hold.is_disabled()
    page.later(lambda: run(line, 1.0, 1e-4))
    # A half sine of 0.1 mm: RMS of 0.1 / sqrt(2), the largest in the middle of 200 mm.
    shown.wait_until(lambda: "newest\t0.1000\t100\t0.0706" in shown.text(), "the first run")
    hold.click()
    shown.wait_until(release.is_visible, "that it is held")
    page.later(lambda: run(line, 10.0, 2.5e-5))
    shown.wait_until(lambda: "newest\t0.0250\t100\t0.0177" in shown.text(), "the second run")
    assert "held\t0.1000\t100\t0.0706" in shown.text()
    assert "newest / held\t0.250\t\t0.250" in shown.text()
    way, _, held, newest = (np.array(column, float) for column in shown.plots()[ALONG]["data"])
    half = np.sin(np.pi * way / 200.0)
    np.testing.assert_allclose(held, 0.1 * half, atol=1e-3)
    np.testing.assert_allclose(newest, 0.025 * half, atol=3e-4)
    files = {curve.label: curve for curve in runs.panel().marks if isinstance(curve, Curve)}
    np.testing.assert_allclose(files["held"].y, 0.1 * np.sin(np.pi * files["held"].x / 200.0), atol=1e-6)
    assert list(files) == ["held", "newest"]
    page.later(lambda: line.place(START, END + 0.1))
    shown.wait_until(lambda: not release.is_visible(), "that it was let go")
    assert "0.1000" not in shown.text()
    assert shown.complaints == []


def test_a_plot_is_written_as_picture_and_table(
    page: Page, open_page: Callable[..., BrowserPage], tmp_path: Path
) -> None:
    """What stands on the page stands in the files to the bit; a file that is there is replaced once that is said."""
    plot = RollingPlot(page, UNITS, ["joint_1", "joint_2"], window=1.0)
    rows = np.array([[0.1 * k, np.sin(k), 1.0 / (k + 1)] for k in range(40)])
    with page.tab("Files"):
        add_plot_export(page)
    shown = open_page(page.address, (1000, 700))

    def press(words: str) -> None:
        shown.page.get_by_role("button", name=words).click()

    def add() -> None:
        for row in rows:
            plot.add(row[0], row[1:])

    press("Write the CSV")
    shown.wait_until(lambda: "plot.csv" in shown.text(), "an empty table")
    assert (tmp_path / "plot.csv").read_text() == f"time [s],joint_1: {UNITS},joint_2: {UNITS}\n"
    page.later(add)
    press("Write the CSV")
    shown.wait_until(lambda: "plot.csv exists" in shown.text(), "the refusal")
    assert len((tmp_path / "plot.csv").read_text().splitlines()) == 1
    press("Replace the file")
    shown.wait_until(lambda: len((tmp_path / "plot.csv").read_text().splitlines()) > 1, "the table")
    head, *body = csv.reader((tmp_path / "plot.csv").read_text().splitlines())
    window = rows[rows[:, 0] >= rows[-1, 0] - 1.0]
    assert head == ["time [s]", f"joint_1: {UNITS}", f"joint_2: {UNITS}"]
    assert np.array(body, float).tolist() == window.tolist()
    press("Write the PNG")
    shown.wait_until((tmp_path / "plot.png").exists, "the picture")
    shown.wait_until(lambda: "written: " in shown.text(), "the word")
    with Image.open(tmp_path / "plot.png") as picture:
        colours = {pixel for _, pixel in picture.convert("RGB").getcolors(1 << 20) or []}
    assert {(0, 0x72, 0xB2), (0xD5, 0x5E, 0)} <= colours  # both curves
    shown.page.locator("input[type=text], input:not([type])").last.fill("../plot")
    press("Write the PNG")
    shown.wait_until(lambda: "../plot.png" in shown.text(), "the refusal of a way out")
    assert not (tmp_path.parent / "plot.png").exists()
    assert shown.complaints == []


def test_curves_with_times_of_their_own_have_columns_of_their_own() -> None:
    """Each abscissa stands before its first curve; where there is no number nothing stands."""
    near, far = np.array([0.0, 0.1]), np.array([0.0, 0.5, 1.0])
    panel = Panel(
        [Curve(near, near + 1.0, "a"), Curve(near, np.array([np.nan, 1 / 3]), "b"), Curve(far, far, "c")], "", "t", "y"
    )
    assert list(csv.reader(table(panel).splitlines())) == [
        ["t", "a: y", "b: y", "c: t", "c: y"],
        ["0.0", "1.0", "", "0.0", "0.0"],
        ["0.1", "1.1", repr(1 / 3), "0.5", "0.5"],
        ["", "", "", "1.0", "1.0"],
    ]
