"""Texts of files and bags are texts on every page: names that HTML, Markdown, a template or a formula would run."""

import re
from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import yaml
from foreign_arms import drive_torque, write
from hostile_texts import TEXTS, check_harmless, hostile, hostile_robot
from report_pages import ReportCheck
from two_joints import CURVES, NAMES, RATE, Bench, fourier

import rx90_emulator as rx
from rx90_common.base.share import SOURCE_RIG, config_path
from rx90_common.report.charts import chart
from rx90_common.report.page import render_page
from rx90_emulator.cli.frame import run
from rx90_emulator.conformance.battery import Nominal, run_cs7b, step
from rx90_emulator.conformance.check import CaseResult, CheckResult
from rx90_emulator.demo.demonstration import RunReport

_NOTE_CANVAS = """() => {
    window.written = [];
    const canvas = CanvasRenderingContext2D.prototype;
    const write = canvas.fillText;
    canvas.fillText = function (text, ...rest) { window.written.push(text); write.call(this, text, ...rest); };
}"""
Arm = tuple[Path, rx.Setup, Path]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory, task_file: Path) -> Arm:
    folder = tmp_path_factory.mktemp("arm") / "<b>robot & 'co'"
    folder.mkdir()
    task = folder / "task"
    task.write_text(re.sub("(rest_.*):.*", r"\1: 0.4", task_file.read_text(encoding="utf-8")), encoding="utf-8")
    setup = rx.Setup.load(hostile_robot(folder, task))
    bag = folder / "<img src=x onerror=window.ran=1> ``` {{7*7}}"
    rx.write_bag(rx.run_line(setup, rx.load_task(folder / "task.yaml"), record_fast=True), bag)
    return folder, setup, bag


def _plotted(arm: Arm, page: Path) -> None:
    assert run("rx90 bag", ["plot", str(arm[2]), "-o", str(page)]) == 0


def _demonstrated(arm: Arm, page: Path) -> None:
    folder, setup, bag = arm
    report = RunReport(bag, setup, rx.load_task(folder / "task.yaml"), 0.0)
    page.write_text(report.page(bag, rx.compare_bags(bag, bag), 1.0, "real time"), encoding="utf-8")


def _measured(arm: Arm, page: Path) -> None:
    words = [str(arm[2]), "--robot", str(arm[0]), "--report", str(page), "--bandwidth", "60"]
    assert run("rx90 identify compare", words) in (0, 1)


def _checked(arm: Arm, page: Path) -> None:
    nominal = Nominal(arm[1], page.parent)
    record = run_cs7b(step(nominal, TEXTS[3]), arm[1])
    record.fault = TEXTS[4]
    page.write_text(CheckResult(TEXTS[5], arm[1], [CaseResult(record, record)]).page, encoding="utf-8")


def _identified(_arm: Arm, page: Path) -> None:
    names = list(TEXTS[:2])
    bench = Bench.make(page.parent)
    urdf = bench.urdf.read_text(encoding="utf-8")
    for name, text in zip(NAMES, names, strict=True):
        urdf = urdf.replace(f'"{name}"', quoteattr(text))
    bench.urdf.write_text(urdf, encoding="utf-8")
    bags = []
    for seed in (1, 2):
        motion = fourier(seed, 20.0)
        torque = drive_torque(bench.model, np.eye(2), CURVES, motion, RATE) + bench.noise(motion, seed)
        bags.append(
            write(page.parent / f"{TEXTS[seed].replace('/', '')}", "/joint_states", names, RATE, (*motion, torque))
        )
    words = ["excitation", bags[0], "--validation", bags[1], "--output", page.parent / "found"]
    assert bench.identify(*words) in (0, 1)
    (page.parent / "found" / "report.html").rename(page)


def _held_against(arm: Arm, page: Path) -> None:
    folder, _, bag = arm
    words = [str(folder / "friction.yaml"), str(bag), "--robot", str(folder)]
    assert run("rx90 identify check", [*words, "--report", str(page)]) in (0, 1)


def _ramped(_arm: Arm, page: Path) -> None:
    rig = page.parent / f"{TEXTS[2]}.yaml"
    content = hostile(yaml.safe_load(config_path(SOURCE_RIG).read_text(encoding="utf-8")))
    rig.write_text(yaml.safe_dump(content), encoding="utf-8")
    out = page.parent / "out"
    assert run("rx90 rig source", ["--repeats", "4", "--rig", str(rig), "--output", str(out)]) in (0, 1)
    (out / "report.html").rename(page)


def _drawn(_arm: Arm, page: Path) -> None:
    shown_texts = [*TEXTS, TEXTS[0]]
    figures = [chart(text, text, text) for text in shown_texts]
    for shown, text in zip(figures, shown_texts, strict=True):
        shown.line([0.0, 1.0], [0.0, 1.0], name=text)
    drawn = [[shown] for shown in figures]
    topics = dict(zip([*TEXTS, "heat"], drawn, strict=True))
    named = {"title": TEXTS[0], "paths": TEXTS, "topics": topics}
    page.write_text(render_page("rx90_common.bags", "bag.html.j2", **named), encoding="utf-8")


@pytest.mark.parametrize(
    ("make", "visible"),
    [
        (_plotted, 6),
        (_demonstrated, 6),
        (_measured, 6),
        (_checked, 6),
        (_identified, 2),
        (_held_against, 6),
        (_ramped, 0),
        (_drawn, 6),
    ],
)
def test_a_report_shows_texts_as_texts(
    make: Callable[[Arm, Path], None], visible: int, arm: Arm, check_report: ReportCheck, tmp_path: Path
) -> None:
    """Nothing runs, nothing is asked for, and names stand there as they are, also where a plot is drawn."""
    page = tmp_path / "page.html"
    make(arm, page)
    report = check_report.open(page)
    report.page.evaluate(_NOTE_CANVAS)
    report.page.set_viewport_size({"width": 900, "height": 900})  # so that plots are drawn again
    for place in report.page.locator("figure.plot").all():
        place.hover()
    check_harmless(report, *TEXTS[:visible])
    assert report.faults == []
    if make is _drawn:
        assert TEXTS[-1] in report.page.evaluate("window.written")
