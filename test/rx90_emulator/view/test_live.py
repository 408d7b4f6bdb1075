"""rx90_view on running nodes, as a browser shows it: they come, move, go, come again, and are of another robot."""

from __future__ import annotations

import re
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from browser import BrowserPage, served
from processes import Processes
from rosbags.rosbag2 import Reader as Rosbag2Reader
from short_task import SHORT_TASK

from rx90_common.exchange.arm_watch import JointSample, Trajectory
from rx90_common.process.children import ChildProcess
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import live as live_module
from rx90_emulator.view.live import LivePlots
from rx90_emulator.view.page import Page

Open = Callable[..., BrowserPage]
ARM = "/arm/" + "/".join(f"joint_{k}" for k in range(1, 7)) + "/tip"
POSE = [0.4, -0.7, 1.9, 0.8, -0.9, 2.5]
SETTLED = 1e-3  # m; the arm gives a little under its weight


def tip(setup: Setup, position: list[float]) -> np.ndarray:
    """Return where the tool centre point is, m, by Pinocchio from the URDF's text."""
    model = pin.buildModelFromXML(setup.robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(position))
    return np.asarray(data.oMf[model.getFrameId(setup.robot.tcp_frame)].translation)


def address(view: ChildProcess) -> str:
    """Wait for the page."""
    return view.wait_for(r"page: (\S+)")[1]


def stopped(view: ChildProcess) -> int:
    """Press Ctrl-C; return the exit code."""
    view.signal(signal.SIGINT)
    return view.wait()


def near(shown: BrowserPage, where: np.ndarray) -> Callable[[], bool]:
    """Return whether the tip is drawn there."""
    return lambda: float(np.linalg.norm(shown.pose(ARM)[:3, 3] - where)) < SETTLED


@pytest.mark.ros
def test_nodes_come_go_and_come_again(shipped: Setup, processes: Processes, open_page: Open) -> None:
    """The page waits for nodes, shows their arm, says that they have gone, and that others are of another robot."""
    view = processes.start("rx90_view", "--port", 0, "--ros-args", "-r", "__ns:=/cell_1")
    shown = open_page(address(view))
    shown.wait_until(lambda: "Waiting for a simulation: nothing on /cell_1/joint_states" in shown.text(), "the wait")
    pose = f"rx90_sim:initial_position:={POSE}"
    cell = processes.start("rx90_cell", "--ros-args", "-r", "__ns:=/cell_1", "-p", pose)
    shown.wait_until(near(shown, tip(shipped, POSE)), "the arm in its pose")
    for words in ("running", "holding", "open"):
        shown.wait_until(lambda words=words: words in shown.text(), words)  # type: ignore[misc]
    cell.signal(signal.SIGINT)
    cell.wait()
    shown.wait_until(lambda: "The simulation has gone" in shown.text(), "the end of the nodes")
    processes.start("rx90_cell", "--ros-args", "-r", "__ns:=/cell_1", "-p", "robot:=tx40")
    shown.wait_until(lambda: "robot is tx40, this page shows rx90b" in shown.text(), "the other robot")
    assert (stopped(view), shown.foreign_requests) == (0, [])


@pytest.mark.ros
def test_the_arm_of_make_view_moves_and_all_ends_with_it(
    shipped: Setup, processes: Processes, open_page: Open, tmp_path: Path
) -> None:
    """With --demo the tip goes to the line's end and again to its start, plots follow, and Ctrl-C ends it."""
    task = tmp_path / "task.yaml"
    task.write_text(SHORT_TASK, encoding="utf-8")
    view = processes.start(
        "rx90_view", "--demo", "--task", task, "--port", 0, "--no-browser", "--output", tmp_path / "out"
    )
    shown = open_page(address(view))
    for end in ((0.6034, -0.2808, 0.1955), (0.6, -0.3, 0.2), (0.6034, -0.2808, 0.1955)):
        shown.wait_until(near(shown, np.array(end)), f"the tip at {end}")
    shown.wait_until(lambda: len(shown.plots()["friction torque [Nm]"]["data"][0]) > 10, "samples of friction")
    friction, deflection = (
        shown.plots()[title]["data"] for title in ("friction torque [Nm]", "bristle deflection [µrad]")
    )
    assert len(friction) == 1 + len(shipped.friction.names)
    assert all(a < b for a, b in zip(friction[0], friction[0][1:], strict=False))
    assert max(map(abs, friction[1])) > 10.0  # joint 1, whose tau_c is 25 Nm, has moved
    assert max(map(abs, deflection[1])) > 100.0  # 25 Nm / 1e5 Nm/rad: 250 microrad
    newest = friction[0][-1]
    shown.wait_until(lambda: shown.plots()["friction torque [Nm]"]["data"][0][-1] > newest, "newer samples")
    shown.wait_until(lambda: "mm now; largest of this run" in shown.text(), "the path error")
    shown.page.get_by_text("Files", exact=True).click()
    shown.page.get_by_role("button", name="Record", exact=True).click()
    shown.wait_until(lambda: "recording to bag: " in shown.text(), "the recording")
    shown.page.get_by_role("button", name="End the recording").click()
    shown.wait_until(lambda: "messages of" in shown.text(), "the end of the recording")
    told = re.search(r"recorded (\d+) messages", shown.text())
    assert told is not None
    with Rosbag2Reader(tmp_path / "out" / "bag") as bag:
        assert bag.message_count == int(told[1]) > 0
        assert {"/joint_states", "/friction_states", "/motor_states"} <= set(bag.topics)
    assert (stopped(view), shown.complaints, shown.foreign_requests) == (0, [], [])


def test_what_was_accepted_before_time_began_again_is_forgotten(
    shipped: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a simulation that was reset, or started again, no trajectory is shown that would begin minutes later."""
    times = iter([300.0, 300.1, 0.2, 0.3])
    zeros = np.zeros(6)
    watch = SimpleNamespace(
        elements=list,
        joints=lambda: [JointSample(next(times), zeros, zeros, zeros)],
        listens_at_ticks=False,
        trajectory=Trajectory(299.0, np.array([305.0]), np.zeros((1, 6)), np.array([True])),
    )
    monkeypatch.setattr(live_module, "ArmWatch", lambda *_: watch)
    live = live_module.LiveSource(SimpleNamespace(node=None), shipped.robot, "rx90_controller")  # type: ignore[arg-type]
    seen = []
    for now in range(4):
        live.take(float(now))
        seen.append(watch.trajectory is None)
    assert seen == [False, False, True, True]


def test_what_the_nodes_publish_is_what_the_plots_show(shipped: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each quantity of each joint stands in its own plot, with its sign and in its unit.

    The loop has both axes, of the joint that is chosen.
    """
    count = len(shipped.friction.names)
    weights, elements = np.arange(1.0, 7.0), np.arange(1.0, count + 1.0)
    now = {"time": 0.0}

    def joints() -> list[JointSample]:
        wave = np.cos(now["time"])
        return [JointSample(now["time"], 0.1 * weights * wave, 0.2 * weights * wave, -30.0 * weights * wave)]

    def friction() -> list[JointSample]:
        wave = np.cos(now["time"])
        return [JointSample(now["time"], 1e-5 * elements * wave, 0.3 * elements * wave, 40.0 * elements * wave)]

    def ticks() -> list[JointSample]:
        samples = []
        for tick in range(max(0, round(1e3 * now["time"]) - 99), round(1e3 * now["time"]) + 1):
            wave, turned = np.cos(1e-3 * tick), np.tanh(1e3 * np.cos(1e-3 * tick))  # friction turns within 2 mrad/s
            samples.append(JointSample(1e-3 * tick, elements, 0.3 * elements * wave, 40.0 * elements * turned))
        return samples

    watch = SimpleNamespace(
        elements=friction, joints=joints, trajectory=None, elements_at_ticks=ticks, listens_at_ticks=True
    )
    monkeypatch.setattr(live_module, "ArmWatch", lambda *_: watch)
    live = live_module.LiveSource(SimpleNamespace(node=None), shipped.robot, "rx90_controller")  # type: ignore[arg-type]
    with served(Page("test", port=0)) as page:
        made: dict[str, Any] = {}
        add = page.gui.add_uplot
        monkeypatch.setattr(page.gui, "add_uplot", lambda *a, **k: made.setdefault(k["title"], add(*a, **k)))
        listed = page.gui.add_dropdown
        monkeypatch.setattr(page.gui, "add_dropdown", lambda *a: made.setdefault(a[0], listed(*a)))
        plots = LivePlots(page, shipped.robot)
        made["joint of the loop"].value, taken = "joint_3", threading.Event()
        page.later(taken.set)
        assert taken.wait(60.0)
        times = np.arange(0.0, 3.0, 0.1)
        for time in times:
            now["time"] = float(time)
            (state,) = live.take(2.0 * time)  # at half the speed of the wall clock
            plots.add(state, live.elements, 5e-5 if time > 1.0 else np.nan)
            plots.add_to_loop(live.friction, at_ticks=True)
        plots.draw()
    assert live.pace(2.0 * times[-1]) == pytest.approx(0.5)
    wave = np.cos(times)
    for title, factors in (
        ("friction torque [Nm]", 40.0 * elements),
        ("bristle deflection [\u00b5rad]", 10.0 * elements),
        ("joint velocity [rad/s]", 0.2 * weights),
        ("drive torque [Nm]", -30.0 * weights),
    ):
        shown = np.array(made[title].data)
        np.testing.assert_allclose(shown[0], times, err_msg=title)
        np.testing.assert_allclose(shown[1:], factors[:, None] * wave, err_msg=title)
    velocity, torque = np.array(made["friction against velocity"].data)
    np.testing.assert_allclose(torque, 120.0 * np.tanh(1e3 / 0.9 * velocity), atol=1e-3)
    assert (velocity.min(), velocity.max()) == pytest.approx((0.9 * wave.min(), 0.9), rel=1e-2)
    # It turns at standstill, and not on a diagonal between samples that are far apart.
    assert len(velocity[np.abs(torque) < 100.0]) > 1
    assert np.abs(velocity[np.abs(torque) < 100.0]).max() < 2e-3
    error = np.array(made["path error of the laser spot [mm]"].data[2])
    np.testing.assert_array_equal(np.isfinite(error), times > 1.0)
    np.testing.assert_allclose(error[times > 1.0], 0.05)
