"""rx90 view on running nodes, as a browser shows it: they come and go, move, and each fact stands in its place."""

import re
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser import BrowserPage
from pinocchio_chain import tip_place
from processes import Processes, wait_until
from short_task import SHORT_TASK

import rx90_emulator as rx
from rx90_common.description.kinematics import tip_position
from rx90_common.exchange.arm_watch import JointSample, NodeStatus, Trajectory
from rx90_common.process.children import ChildProcess
from rx90_controller.lines.plan import approached
from rx90_emulator.view import live as live_module
from rx90_emulator.view.live import LiveView
from rx90_emulator.view.page import Page
from rx90_emulator.view.scene import LineScene

Open = Callable[..., BrowserPage]
ARM = "/arm/" + "/".join(f"joint_{k}" for k in range(1, 7)) + "/tip"
POSE = [0.4, -0.7, 1.9, 0.8, -0.9, 2.5]
SIZE = (700, 400)  # a small scene, because it is drawn in software
SETTLED = 1e-3  # m; the arm gives a little under its weight


def address(view: ChildProcess) -> str:
    return view.wait_for(r"page: (\S+)")[1]


def stopped(view: ChildProcess) -> int:
    view.signal(signal.SIGINT)
    return view.wait()


def near(shown: BrowserPage, where: np.ndarray) -> Callable[[], bool]:
    return lambda: float(np.linalg.norm(shown.pose(ARM)[:3, 3] - where)) < SETTLED


@pytest.mark.ros
def test_nodes_come_go_and_come_again(shipped: rx.Setup, processes: Processes, open_page: Open) -> None:
    """The page waits for nodes, shows their arm, says that they have gone, and that others are of another robot."""
    view = processes.start("rx90 view", "--port", 0, "--ros-args", "-r", "__ns:=/cell_1")
    shown = open_page(address(view), SIZE, pictures="few")
    shown.wait_until(lambda: "Waiting for a simulation: nothing on /cell_1/joint_states" in shown.text(), "the wait")
    pose = f"rx90_sim:initial_position:={POSE}"
    cell = processes.start("rx90_cell", "--ros-args", "-r", "__ns:=/cell_1", "-p", pose)
    shown.wait_until(near(shown, tip_place(shipped.robot, POSE)), "the arm in its pose")
    for words in ("running", "holding", "open"):
        shown.wait_until(lambda words=words: words in shown.text(), words)  # type: ignore[misc]
    cell.signal(signal.SIGINT)
    cell.wait()
    shown.wait_until(lambda: "The simulation has gone" in shown.text(), "the end of the nodes")
    processes.start("rx90_cell", "--ros-args", "-r", "__ns:=/cell_1", "-p", "robot:=tx40")
    shown.wait_until(lambda: "robot is tx40, this page shows rx90b" in shown.text(), "the other robot")
    assert (stopped(view), shown.foreign_requests) == (0, [])


@pytest.mark.ros
def test_the_arm_of_make_view_moves_and_all_ends_with_it(processes: Processes, open_page: Open, tmp_path: Path) -> None:
    """With --demo the tip goes to the line's end and again to its start, the page is locked, and Ctrl-C ends it."""
    task = tmp_path / "task.yaml"
    task.write_text(SHORT_TASK, encoding="utf-8")
    view = processes.start("rx90 view", "--demo", "--task", task, "--port", 0, "--no-browser")
    code = view.wait_for(r"code to move the arm: (\S+)")[1]
    shown = open_page(address(view), SIZE, pictures="few")
    for end in ((0.6034, -0.2808, 0.1955), (0.6, -0.3, 0.2)):
        shown.wait_until(near(shown, np.array(end)), f"the tip at {end}")
    shown.wait_until(lambda: "mm now; largest of this run" in shown.text(), "the path error")
    shown.page.get_by_role("tab", name="Move").click()
    shown.button("Unlock").wait_for()
    assert len(code) == 8
    assert code not in shown.text()
    assert (stopped(view), shown.complaints, shown.foreign_requests) == (0, [], [])


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    made = Page("test", port=0)
    yield made
    made.close()


@pytest.fixture
def view_of(page: Page, shipped: rx.Setup, monkeypatch: pytest.MonkeyPatch) -> Callable[..., LiveView]:
    no_client: Any = SimpleNamespace(node=None)
    monkeypatch.setattr(live_module, "ArmScene", lambda *_: SimpleNamespace(show=lambda _: None))

    def make(watch: Any, line: rx.LineTask | None = None) -> LiveView:
        monkeypatch.setattr(live_module, "ArmWatch", lambda *_: watch)
        return LiveView(page, no_client, shipped.robot, "rx90_controller", line)

    return make


def test_what_was_accepted_before_time_began_again_is_forgotten(view_of: Callable[..., LiveView]) -> None:
    """Of a simulation that was reset, or started again, no trajectory is shown that would begin minutes later."""
    times = iter([300.0, 300.1, 0.2, 0.3])
    zeros = np.zeros(6)
    watch = SimpleNamespace(
        joints=lambda: [JointSample(next(times), zeros, zeros, zeros)],
        trajectory=Trajectory(299.0, np.array([305.0]), np.zeros((1, 6)), np.array([True])),
    )
    view, seen = view_of(watch), []
    for now in range(4):
        view._update(float(now))
        seen.append(watch.trajectory is None)
    assert seen == [False, False, True, True]


GOOD, WARNING, ERROR = "#2b8a3e", "#e67700", "#c92a2a"
ROW = re.compile(r"<td[^>]*>([^<]*)</td><td[^>]*>(.*?)</td>")


def test_each_fact_stands_in_its_row(view_of: Callable[..., LiveView]) -> None:
    """Brakes, controller, pace and trajectory are the nodes' own, with colours."""
    simulated = [100.0]
    watch = SimpleNamespace(
        trajectory=None, publishers=1, robot=None, problem="", look_around=lambda: None,
        joints=lambda: [JointSample(simulated[0], *np.zeros((3, 6)))],
        diagnostics={
            "rx90_sim": NodeStatus(1, "late", {"brakes": "closed"}),
            "rx90_controller": NodeStatus(0, "holding", {"enabled": "true"}),
        },
    )  # fmt: skip
    view = view_of(watch, rx.load_task())

    def rows(now: float) -> dict[str, str]:
        simulated[0] = 100.0 + 0.25 * now
        view._update(now)
        view._show_status(now)
        return dict(ROW.findall(view._status.content))

    rows(0.0)
    assert rows(0.01)["time"] == "100.00 s"  # no pace of two messages that have come together
    shown = rows(2.0)
    assert (shown["brakes"], shown["trajectory"]) == ("closed", "none")
    assert shown["time"] == "100.50 s, 0.25 &times; real time"
    assert (f"color:{WARNING}" in shown["simulation"], f"color:{GOOD}" in shown["controller"]) == (True, True)
    watch.trajectory = Trajectory(60.0, np.array([1060.0]), np.zeros((1, 6)), np.array([True]))
    assert rows(2.4)["trajectory"] == "40.6 of 1000.0 s"
    watch.trajectory = Trajectory(60.0, np.array([100.2]), np.zeros((1, 6)), np.array([True]))
    watch.diagnostics = {
        "rx90_sim": NodeStatus(0, "running", {"brakes": "open"}),
        "rx90_controller": NodeStatus(2, "joint_2: <following> error", {"enabled": "false"}),
    }
    shown = rows(2.8)
    assert (shown["brakes"], shown["trajectory"]) == ("open", "ended at 100.2 s")
    assert f'color:{ERROR};font-weight:600">joint_2: &lt;following&gt; error<' in shown["controller"]


START, END = np.array([0.5, 0.0, 0.2]), np.array([0.9, 0.0, 0.2])
LINE = rx.LineTask(tuple(START), tuple(END))
REST = np.array([True, True])
LATE = 90  # samples before the trajectory is known


@pytest.mark.parametrize("of", ["line", "circle"])
def test_the_largest_is_that_of_the_run(shipped: rx.Setup, page: Page, of: str) -> None:
    """What counts on the page is what `path_accuracy` counts, though the trajectory comes late; backwards nothing."""
    task = replace(rx.load_task() if of == "line" else rx.load_path("paths/circle.yaml"), rest_before=0.05)
    plan = rx.plan_path(shipped, task)
    limits = shipped.controller.limits(shipped.robot)
    here = plan.start_pose + 0.05
    line = approached(plan, here, limits, shipped.rates.position_period, True)
    run = rx.simulate(shipped, line.points, here)
    times, position = run.times[::10], run.slow.joint_states[::10, 0]
    expected = rx.path_accuracy(shipped.robot, task, times, position, line.approach)
    meter = LineScene(page, "/line", task)
    spots = tip_position(shipped.robot.chain, position)

    def add(rows: range) -> np.ndarray:
        return np.concatenate([meter.add(times[k : k + 3], spots[k : k + 3]) for k in rows])

    assert np.isnan(add(range(0, LATE, 3))).all()
    assert times[LATE - 1] > line.approach + task.rest_before + 0.3
    assert meter.words() == "not on the line"
    points = line.points
    at_rest = np.equal(points.velocity, 0.0).all(axis=1)
    tips = tip_position(shipped.robot.chain, points.position)
    back = LineScene(page, "/back", task)
    back.follow(points.times, tips[::-1], at_rest[::-1])
    assert np.isnan(back.add(times, spots)).all()
    meter.follow(points.times, tips, at_rest)
    seen = add(range(LATE, len(times), 3))
    counted = times[LATE:][np.isfinite(seen)]
    late = expected.times >= times[LATE]
    count = int(late.sum())
    assert len(counted) - count <= 1  # the trajectory's last knot is half a set-point behind the line's end
    np.testing.assert_allclose(counted[:count], expected.times[late])
    np.testing.assert_allclose(seen[np.isfinite(seen)][:count], expected.perpendicular[late], atol=1e-12)
    row = np.argmax(expected.perpendicular)
    assert meter.largest == pytest.approx((expected.worst, expected.along[row]))
    said = f"not on the line; last run {1e3 * expected.worst:.3f} mm, {1e3 * expected.along[row]:.0f} mm from the start"
    assert meter.words() == said


def spot(times: np.ndarray, begin: float, error: float) -> np.ndarray:
    """Return a spot that goes along the line in 4 s, and is so far from it, m."""
    share = np.clip((times - begin) / 4.0, 0.0, 1.0)[:, None]
    return np.asarray(START + share * (END - START) + [0.0, 0.0, error])


def test_a_run_stays_until_the_next_one_begins(page: Page) -> None:
    """Neither the end of a run nor a new beginning of time takes it away; no sample of it counts for the next one."""
    meter = LineScene(page, "/line", LINE)
    times = np.arange(0.0, 8.0, 0.01)
    ends = np.stack([START, END])
    for error in (3e-5, 1e-5):
        meter.follow(np.array([2.0, 6.0]), ends, REST)
        meter.add(times, spot(times, 2.0, error))
        assert meter.largest[0] == pytest.approx(error)
        meter.begin_again()
        meter.add(times, spot(times, 2.0, 1.0))
        assert meter.largest[0] == pytest.approx(error)
    for shift, error in ((8.0, 9e-6), (16.0, 5e-6)):
        meter.follow(np.array([2.0, 6.0]) + shift, ends, REST)
        meter.add(times + shift, spot(times, 2.0, error))
        assert meter.largest[0] == pytest.approx(error)
    meter.follow(np.array([26.0, 30.0]), ends[::-1], REST)  # back
    assert np.isnan(meter.add(times + 24.0, spot(times, 2.0, 1.0))).all()
    assert meter.largest[0] == pytest.approx(5e-6)


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # a thread that has just ended
            found += map(int, (task / "children").read_text().split())
    return found


@pytest.mark.ros
@pytest.mark.parametrize("said", ["starting simulation", "page: "])
def test_ctrl_c_while_the_nodes_come_up(processes: Processes, said: str) -> None:
    """Ctrl-C before the arm is seen ends page and nodes with 130, one line, and no process left behind."""
    view = processes.start("rx90 view", "--demo", "--port", 0, "--no-browser")
    view.wait_for(said)
    wait_until(lambda: bool(_children(view.pid)), "the nodes' process")
    children = _children(view.pid)
    view.signal(signal.SIGINT)
    assert view.wait() == 130
    assert "Traceback" not in view.output
    assert view.lines[-1] == "rx90 view: interrupted"
    for child in children:
        wait_until(lambda child=child: not Path(f"/proc/{child}").exists(), "the end of the nodes")  # type: ignore[misc]
