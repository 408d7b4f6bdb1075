"""The demonstration: nodes in processes run the reference task; bags are compared, a report is written.

The report is one self-contained HTML page with the numbers and plots of a recorded run of a line.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rx90_common.bags.comparison import BagComparison, Verdict, compare_bags
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.summary import summarise
from rx90_common.bags.tables import comparison_text
from rx90_common.base.errors import ProcessError
from rx90_common.description.robot_files import RobotFiles, provenance_of
from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ChildProcess, ProcessGroup, executable
from rx90_common.process.files import write_text
from rx90_common.report.page import render_page
from rx90_controller.lines.plan import plan_line
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.demo.animation import animate
from rx90_emulator.demo.plots import effort, friction, path_error, tracking
from rx90_emulator.loop.line import path_accuracy, run_line
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import CODE, OPENED, TO_OTHERS
from rx90_sim.node.simulation_client import SimulationClient

SWITCHED_OFF = "without feed-forward, D on the measured velocity alone"
"""What the recorded run is compared with, by the name that it has in docs/explanation/models.md."""

PATH_LIMIT = 1e-4
"""Path accuracy that laser welding asks for, m (the paper's introduction)."""


class RunReport:
    """What the report of a recorded run of a line shows.

    Args:
        bag: what was recorded.
        setup: of the run.
        task: the line.
        start_time: when its trajectory started, s.

    Attributes:
        bag, setup, task: as given.
        joints: the bag's joint_states.
        friction: the bag's friction_states.
        error: the bag's tracking_error.
        path: path error of the recorded run.
        path_without: path error of the same task with FF and dq_r off, computed without ROS.
    """

    def __init__(self, bag: Path, setup: Setup, task: LineTask, start_time: float) -> None:
        self.bag = bag
        self.setup = setup
        self.task = task
        names = setup.robot.joint_names
        self.joints = read_joint_states(bag, "joint_states", names)
        self.friction = read_joint_states(bag, "friction_states", setup.friction.names)
        self.error = read_joint_states(bag, "rx90_controller/tracking_error", names)
        self.path = path_accuracy(
            setup.robot, task, self.joints.time, self.joints.fields["position"], start_time
        )
        controller = setup.controller.replaced(feed_forward=setup.controller.feed_forward.off())
        self.path_without = run_line(replace(setup, controller=controller), task).path_accuracy

    def write(
        self,
        page: Path,
        baseline: Path,
        comparison: BagComparison,
        *,
        pace: float,
        reached: float,
        composed: bool,
    ) -> None:
        """Write the page.

        Args:
            page: the file.
            baseline: the bag it was compared with.
            comparison: of the two bags.
            pace: the real-time factor that was asked for; 0 for none.
            reached: the one that was reached, simulated time over wall time.
            composed: whether simulation and controller shared a process.
        """
        setup = self.setup
        files = self.setup.files
        text = render_page(
            "rx90_emulator.demo",
            "report.html.j2",
            robot=setup.robot.model.name,
            provenance={}
            if files is None
            else {getattr(files, k).name: v for k, v in provenance_of(files).items()},
            run=self,
            real_time_factor=reached,
            pace=pace,
            composed=composed,
            messages=sum(topic.count for topic in summarise(self.bag).topics),
            baseline=baseline,
            limit=PATH_LIMIT,
            switched_off=SWITCHED_OFF,
            top=max(PATH_LIMIT, self.path.worst),
            animation=animate(self.joints, self.path, setup.robot, self.task),
            same=comparison.verdict is Verdict.SAME,
            topics=comparison.topics,
            joints=_joint_rows(self),
            friction=list(zip(setup.friction.names, setup.friction.elements, strict=True)),
            plots={
                "path": path_error(self.path, self.path_without, SWITCHED_OFF, PATH_LIMIT),
                "tracking": tracking(self.joints, self.error),
                "friction": friction(self.friction),
                "effort": effort(self.joints),
            },
        )
        write_text(page, text)


def _joint_rows(run: RunReport) -> list[tuple[str, float, float, float, float]]:
    """Return per joint: fastest rad/s, worst and RMS position error mrad, largest drive torque Nm."""
    moving = (run.error.time >= run.path.times[0]) & (run.error.time <= run.path.times[-1])
    error = run.error.fields["position"][moving]
    columns = (
        np.abs(run.joints.fields["velocity"]).max(axis=0),
        np.abs(error).max(axis=0) * 1e3,
        np.sqrt(np.mean(error**2, axis=0)) * 1e3,
        np.abs(run.joints.fields["effort"]).max(axis=0),
    )
    return list(zip(run.joints.names, *(column.tolist() for column in columns), strict=True))


START_TIME = 0.25
"""When the trajectory starts, s: late enough to arrive before it, whatever the machine does, because time
stands still until every process is there."""
_PAGE_TIMEOUT = 20.0  # s, for a person to open the page
_SERVICE_TIMEOUT = 60.0
_BAR = "{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}{postfix}]"


class Demonstration:
    """A run of the reference task in a folder of its own.

    Args:
        robot: the name or folder of the robot, for the processes.
        files: its files, and the task.
        pace: the real-time factor; 0 is as fast as it goes.
        composed: simulation and controller share a process.
        view: options of `rx90 view` for a page in the browser beside it; None for no page.
    """

    def __init__(
        self,
        robot: str,
        files: RobotFiles,
        pace: float,
        composed: bool = False,
        view: Sequence[object] | None = None,
    ) -> None:
        self._robot = robot
        self._task_file = files.required("task")
        self._motion = ("--robot", robot, self._task_file, "--start-time", START_TIME)
        self._pace = pace
        self._composed = composed
        self._view = view
        self._setup = Setup.load(files)
        self._task = load_task(self._task_file)
        self._plan = plan_line(self._setup.robot, self._task, self._setup.rates.position_period)

    def run(self, folder: Path) -> bool:
        """Run, compare, report; return whether the run is the same as the closed loop and within the limit.

        Args:
            folder: an empty one, with a folder `log` in it.
        """
        recorded = folder / "recorded"
        baseline = folder / "closed_loop"
        page = folder / "report.html"
        print("closed loop without ROS ...", flush=True)
        # A process of its own: while it compiles, numba would swallow Ctrl-C.
        with ProcessGroup(folder / "log") as group:
            group.start(
                "closed_loop", executable("rx90 run", *self._motion, "--output", baseline)
            ).expect_success()
        factor = self._run_processes(folder, recorded)
        print("comparing the recorded run with the closed loop without ROS ...", flush=True)
        comparison = compare_bags(recorded, baseline)
        print(comparison_text(comparison))
        run = RunReport(recorded, self._setup, self._task, START_TIME)
        run.write(
            page, baseline, comparison, pace=self._pace, reached=factor, composed=self._composed
        )
        print(
            f"path error: worst {run.path.worst * 1e3:.4f} mm, "
            f"{run.path_without.worst * 1e3:.4f} mm {SWITCHED_OFF}; asked for: {PATH_LIMIT * 1e3:g} mm"
        )
        print(f"report: {page.resolve()}")
        if run.path.worst > PATH_LIMIT:
            print("rx90 demo: the path error is above what was asked for", file=sys.stderr)
        return run.path.worst <= PATH_LIMIT and comparison.verdict is Verdict.SAME

    def _run_processes(self, folder: Path, bag: Path) -> float:
        """Run the processes to the end of the task; return the real-time factor."""
        duration = START_TIME + self._plan.duration
        pose = ", ".join(repr(float(angle)) for angle in self._plan.start_pose)
        of_robot = ("-p", f"robot:={self._robot}")
        given = {
            "initial_position": f"[{pose}]",
            "duration": duration,
            "real_time_factor": self._pace,
            "paused": "true",
        }
        parameters = [
            word for name, value in given.items() for word in ("-p", f"rx90_sim:{name}:={value}")
        ]
        print("starting simulation, controller, trajectory and recorder ...", flush=True)
        with ProcessGroup(folder / "log") as group:
            recorder = group.start("recorder", executable("rx90 bag", "record", "--output", bag))
            node = "rx90_cell" if self._composed else "rx90_sim"
            simulation = group.start(
                "simulation", executable(node, "--ros-args", *parameters, *of_robot)
            )
            if not self._composed:
                group.start("controller", executable("rx90_controller", "--ros-args", *of_robot))
            line = group.start("trajectory", executable("rx90 line", *self._motion))
            if self._view is not None:
                about = ("--robot", self._robot, "--task", self._task_file)
                _wait_for_page(group.start("view", executable("rx90 view", *about, *self._view)))
            recorder.wait_for("ready: all")
            line.expect_success()
            factor = _follow_clock(simulation, duration)
            simulation.expect_success()
            recorder.signal(signal.SIGINT)
            recorder.expect_success()
        return factor


def _wait_for_page(page: ChildProcess) -> None:
    """Give a person a moment to open the page before time runs."""
    address = page.wait_for(r"page: (.*) [(]")[1]
    for line in page.lines:
        if line == TO_OTHERS or line.startswith(CODE):
            print(line)
    print(
        f"page: {address}; time runs once it is open, at the latest in {_PAGE_TIMEOUT:g} s",
        flush=True,
    )
    try:
        page.wait_for(OPENED, _PAGE_TIMEOUT)
    except ProcessError:
        if page.returncode is not None:
            raise


def _follow_clock(process: ChildProcess, duration: float) -> float:
    """Let time run and draw a progress bar of simulated time until the simulation's process ends.

    Returns:
        The real-time factor from the first to the last time that was heard; 0 if there were no two.
    """
    # From the first time that is heard: before it, the nodes wait for those who listen.
    heard: list[tuple[float, float]] = []  # simulated, of the clock: the first and the last
    with client_node("rx90_demo", _SERVICE_TIMEOUT, lambda _: None) as client:
        simulation = SimulationClient(client)
        simulation.pause(False)
        bar = tqdm(
            total=duration,
            bar_format=_BAR,
            desc="reference task",
            mininterval=0.2,
            miniters=0,
            disable=None,
        )
        with bar:
            factor = 0.0
            while process.returncode is None:
                client.spin()
                if simulation.time > (heard[-1][0] if heard else 0.0):
                    heard[1:] = [(simulation.time, time.monotonic())]
                    (begin, first) = heard[0]
                    (end, last) = heard[-1]
                    factor = (end - begin) / (last - first) if last > first else 0.0
                bar.set_postfix_str(f"{factor:.2f} x real time", refresh=False)
                bar.update(min(simulation.time, duration) - bar.n)
            if process.returncode == 0:
                bar.update(duration - bar.n)
    return factor
