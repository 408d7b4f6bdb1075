"""Bags played on the page, in a real browser."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from bag_making import joint_state, write_ros2
from browser import BrowserPage, served
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import scene
from rx90_emulator.view.page import Page
from rx90_emulator.view.player import BagPlayer, open_player

JOINTS = [f"joint_{k}" for k in range(1, 7)]
STEP = 2_000_000
START = 1_700_000_000 * 10**9  # of the wall clock
PIXEL = 1e-6  # m; positions go to the page as single precision
DISTANCES = """() => Object.values(window.__viserTestpoints.uplots).map(plot => plot.chart).find(
    chart => chart.root.querySelector('.u-title').textContent == 'distance of the tips [mm]'
    ).data.map(column => Array.from(column))"""
WORST = 350  # the message of the second bag that is farthest from that of the first one


class Played(NamedTuple):
    """Two bags and the page that plays them."""

    player: BagPlayer
    page: Page
    bags: tuple[Path, Path]


def motion(time: float) -> np.ndarray:
    """Return joint angles, rad, at a time, s."""
    return np.array([0.4 * np.sin((0.5 + 0.3 * k) * time + k) for k in range(6)])


@pytest.fixture
def played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Played]:
    """Serve a page with two bags of two seconds; the second lacks 0.2 s and differs most at one message.

    The arms' frames are there without their shapes, which take Chromium long to draw without a graphics card.
    """
    monkeypatch.setattr(scene, "drawn_shapes", lambda _: [])
    first, second = [], []
    for k in range(1000):
        at, q = START + k * STEP, motion(k * 2e-3)
        first.append(("/joint_states", at, joint_state(at, JOINTS, q, 2.0 * q, 100.0 * q)))
        other = q + 1e-3 * (1.0 + (k == WORST))
        if not 500 <= k < 600:
            second.append(("/joint_states", at, joint_state(at, JOINTS, other, 2.0 * q, 100.0 * q)))
    bags = (write_ros2(tmp_path / "first", first), write_ros2(tmp_path / "second", second))
    page, player = open_player(lambda: Page("test", port=0), bags, RobotFiles(), MeasuredLayout(), 0)
    with served(page):
        yield Played(player, page, bags)


def tip(setup: Setup, bag: Path, stamp: int) -> np.ndarray:
    """Return the tip's pose (4, 4) by Pinocchio at the joint angles that rosbags reads of a bag at a stamp."""
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages(start=stamp):
            message = reader.deserialize(raw, connection.msgtype)
            break
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
    order = [message.name.index(joint) for joint in JOINTS]
    model = pin.buildModelFromXML(setup.robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, message.position[order])
    return np.asarray(data.oMf[model.getFrameId(setup.robot.tcp_frame)].homogeneous)


def scrub(shown: BrowserPage, time: str) -> None:
    """Type a time into the number beside the slider."""
    shown.page.locator("input[inputmode=decimal]").fill(time)


def test_scrubbing_shows_what_was_recorded(
    played: Played, open_page: Callable[..., BrowserPage], shipped: Setup
) -> None:
    """At a time that is chosen on the page both arms' tips are where Pinocchio has them for the recorded angles.

    In a gap an arm is not drawn, the button leads to the worst difference, curves keep its peak, and playing ends.
    """
    shown = open_page(played.page.address, (500, 400))
    player, bags = played.player, played.bags

    def wait_for_both_at(message: int) -> list[np.ndarray]:
        poses = [tip(shipped, bag, START + message * STEP) for bag in bags]
        for drawn, pose in zip(player.arms, poses, strict=True):
            shown.wait_until(lambda: bool(np.allclose(shown.pose(drawn.tip), pose, atol=PIXEL)), f"message {message}")  # noqa: B023
        return [pose[:3, 3] for pose in poses]

    scrub(shown, "1.456")
    wait_for_both_at(728)
    scrub(shown, "1.1")
    shown.wait_until(lambda: "no states of second" in shown.text(), "word of the gap")
    ghost = "() => window.__viserMutable.nodeRefFromName['/ghost'].visible"
    shown.wait_until(lambda: not shown.page.evaluate(ghost), "the ghost to go")
    shown.page.get_by_text("Jump to the worst difference").dispatch_event("click")
    tips = wait_for_both_at(WORST)
    shown.page.get_by_label("ghost", exact=True).dispatch_event("click")
    shown.wait_until(lambda: not shown.page.evaluate(ghost), "the ghost to be hidden")
    shown.page.get_by_label("ghost", exact=True).dispatch_event("click")
    shown.wait_until(lambda: bool(shown.page.evaluate(ghost)), "the ghost to come")
    worst = 1e3 * np.linalg.norm(tips[1] - tips[0])
    text = re.compile(r"tips at most ([\d.]+) mm apart, at ([\d.]+) s")
    shown.wait_until(lambda: bool(text.search(shown.text())), "word of the worst difference")
    said = text.search(shown.text())
    assert said
    assert (float(said[1]), said[2]) == (pytest.approx(worst, rel=1e-3), "0.700")
    _, _, *parts, line, _ = shown.page.evaluate(DISTANCES)
    assert np.nanmax(np.array(parts, dtype=float)) == pytest.approx(worst, rel=1e-9)
    assert np.nanmax(np.array(line, dtype=float)) == pytest.approx(worst, rel=1e-9)
    assert len(parts) == 2  # before the gap and after it
    shown.page.get_by_text("Play", exact=True).dispatch_event("click")
    wait_for_both_at(999)
    shown.page.get_by_text("Play", exact=True).wait_for()
    assert (shown.complaints, shown.foreign_requests) == ([], [])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["first", "later"], "no time in common; accepted: --align"),
        (["first"] * 3, "3 bags; accepted: one, or two"),
        (["first", "--align", "start"], "--align start with 1 bags; accepted: two bags"),
        (["first", "first", "--align", "noon"], "--align is 'noon'; accepted: start, trajectory, or a time"),
        (["--record-time"], "--record-time without a bag"),
        (["first", "--demo"], "--demo with the bag first"),
        (["first", "--nice", "0"], "--nice with the bag first"),
        (["nothing"], "nothing: no such bag"),
        (["first", "--robot", "tx40"], "recorded of the robot 'rx90b', not of"),
    ],
)
def test_bags_that_cannot_be_played_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    """What cannot be played is one line with what is accepted, and exit code 2, before any page is served."""
    monkeypatch.chdir(tmp_path)
    reference = Path(__file__).resolve().parents[2] / "reference" / "reference_task"
    (tmp_path / "first").symlink_to(reference)
    if "later" in words:
        states = [joint_state(START + k * STEP, JOINTS, [0.1] * 6) for k in range(5)]
        write_ros2(tmp_path / "later", [("/joint_states", k, state) for k, state in enumerate(states)])
    assert run("rx90_view", [*words, "--port", "0"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert said in err
    assert err.startswith("rx90_view: ")
