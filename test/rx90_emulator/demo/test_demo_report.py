"""The demonstration: its folder, its report, the arm along its line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rx90_emulator as rx
from rx90_common.bags.comparison import compare_bags
from rx90_common.description.kinematics import forward
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.demo.animation import Animation, animate
from rx90_emulator.demo.demonstration import RunReport
from rx90_emulator.loop.setup import Setup


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, shipped: Setup, task: rx.LineTask) -> Path:
    """Return the bag of a short line."""
    folder = tmp_path_factory.mktemp("demo") / "run"
    rx.write_bag(rx.run_line(shipped, task, record_fast=True), folder)
    return folder


@pytest.fixture(scope="module")
def run(bag: Path, shipped: Setup, task: rx.LineTask) -> RunReport:
    """Return what the report shows of it."""
    return RunReport(bag, shipped, task, 0.0)


@pytest.fixture(scope="module")
def animation(run: RunReport, shipped: Setup, task: rx.LineTask) -> Animation:
    """Return its animation."""
    return animate(run.joints, run.path, shipped.robot, task)


@pytest.fixture(scope="module")
def pages(bag: Path, run: RunReport) -> list[Path]:
    """Return the report, written twice."""
    found = [bag.parent / "report.html", bag.parent / "again.html"]
    for page in found:
        run.write(page, bag, compare_bags(bag, bag), pace=0.0, reached=1.0, composed=False)
    return found


def test_the_same_run_gives_the_same_page(pages: list[Path]) -> None:
    """A report of the same run has the same bytes: no counter, no chance, no date of its libraries."""
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_an_arm_of_meshes_is_animated(run: RunReport, task: rx.LineTask, tmp_path: Path) -> None:
    """Whose URDF names files of meshes, which cannot be drawn, gets a report with rods, not an error at the end."""
    mesh = '<visual><geometry><mesh filename="package://nowhere/link.stl"/></geometry></visual>'
    text = re.sub(r"<visual.*?</visual>", mesh, RobotFiles().urdf.read_text(encoding="utf-8"), flags=re.DOTALL)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(text, encoding="utf-8")
    found = animate(run.joints, run.path, load_robot(urdf, RobotFiles().tool), task)
    assert len(found.outlines(found.still)) > 6


def test_the_animated_arm_is_where_kinematics_say(
    animation: Animation, run: RunReport, shipped: Setup, task: rx.LineTask
) -> None:
    """In every frame the tip is that of the recorded joints, and its deviation is enlarged as much as is said."""
    assert animation.times[0] == 0.0
    assert animation.error.max() == run.path.worst
    start, end = np.array(task.start), np.array(task.end)
    direction = (end - start) / np.linalg.norm(end - start)
    chain, position = shipped.robot.chain, run.joints.position
    assert position is not None
    rows = [int(np.argmin(np.abs(run.joints.time - run.path.times[0] - time))) for time in animation.times]
    tips = forward(chain, position[rows]).position
    off = tips - start - ((tips - start) @ direction)[:, None] * direction
    assert np.allclose(np.linalg.norm(off, axis=1), animation.error, atol=1e-12)
    enlarged = tips + (animation.enlarged - 1.0) * off
    base = animation.views[:, -1]
    assert np.allclose(base, base[0])  # the eye stands still
    assert np.allclose(base[0, :, :3] @ base[0, :, :3].T, np.eye(3) * (base[0, 0, :3] @ base[0, 0, :3]))
    seen = enlarged @ base[0, :2, :3].T + base[0, :2, 3]
    assert np.allclose(animation.trail, seen * (1.0, -1.0))
    flange = animation.views[:, 5, :, :3] @ chain.tcp_position + animation.views[:, 5, :, 3]
    joint_6 = forward(chain._replace(tcp_position=np.zeros(3)), position[rows]).position
    direct = tips @ base[0, :, :3].T + base[0, :, 3]
    assert np.allclose(joint_6 @ base[0, :, :3].T + base[0, :, 3], animation.views[:, 5, :, 3], atol=1e-6)
    assert np.allclose(np.linalg.norm(flange - animation.views[:, 5, :, 3], axis=1),
                       np.linalg.norm(direct - animation.views[:, 5, :, 3], axis=1))  # fmt: skip


def test_the_report_in_a_browser(check_report: Any, pages: list[Path], animation: Animation) -> None:
    """The page holds to what all reports do; its arm is scrubbed and played, and stands still without scripts."""
    check_report(pages[0])
    report = check_report.open(pages[0], viewport={"width": 1200, "height": 900})
    page, last = report.page, len(animation.times) - 1
    assert outlines(page) == pytest.approx(drawn(animation, animation.still), abs=0.2)
    page.locator(".player input").fill("0")
    assert outlines(page) == pytest.approx(drawn(animation, 0), abs=0.2)
    assert page.locator(".player output").inner_text().startswith("0.00 s, ")
    page.locator(".player button").click()
    page.wait_for_function(f"() => document.querySelector('.player input').value === '{last}'")
    assert outlines(page) == pytest.approx(drawn(animation, last), abs=0.2)
    tip = page.locator(".player .tip")
    assert [float(tip.get_attribute(at)) for at in ("cx", "cy")] == pytest.approx(
        animation.trail[last].tolist(), abs=0.01
    )
    assert page.locator(".player button").inner_text() == "play"
    assert report.faults == []
    assert check_report.pages_of_paper(report) >= 3
    page.context.close()
    plain = check_report.open(pages[0], java_script_enabled=False)
    assert plain.page.locator("noscript").count() == plain.page.locator("figure.plot").count()
    assert plain.page.locator(".player polygon").first.is_visible()
    assert not plain.page.locator(".player button").is_visible()
    plain.page.context.close()


def outlines(page: Any) -> list[float]:
    """Return the corners of the boxes around the shapes, shape by shape, as the browser has them."""
    texts = page.locator(".player polygon").evaluate_all(
        "all => all.map(one => [Number(one.dataset.shape), one.getAttribute('points')])"
    )
    return boxes([(int(which), text) for which, text in texts])


def drawn(animation: Animation, frame: int) -> list[float]:
    """Return the same as the page should have it."""
    return boxes(animation.outlines(frame))


def boxes(shapes: list[tuple[int, str]]) -> list[float]:
    """Return the lowest and highest coordinates of each outline."""
    found = []
    for _, text in sorted(shapes):
        points = np.array([[float(v) for v in point.split(",")] for point in text.split()])
        found += [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()]
    return found
