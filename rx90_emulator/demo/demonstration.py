"""The demonstration: nodes in processes run the reference task; bags are compared, a report is written.

The report is one self-contained HTML page with the numbers and plots of a recorded run of a line.
"""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from bokeh.models import DataRange1d
from bokeh.plotting import figure
from tqdm import tqdm

from rx90_common.bags.comparison import BagComparison, Verdict, compare_bags
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.tables import comparison_text
from rx90_common.base.arrays import Array
from rx90_common.description.robot_files import RobotFiles, provenance_of
from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ChildProcess, ProcessGroup, executable
from rx90_common.process.files import write_text
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.page import render_page
from rx90_common.report.style import COLOURS, INK
from rx90_controller.lines.plan import plan_line
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop.line import PathAccuracy, path_accuracy, run_line
from rx90_emulator.loop.setup import Setup
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

    def page(self, baseline: Path, comparison: BagComparison, factor: float, pace: str) -> str:
        """Return the text of the page.

        Args:
            baseline: the bag it was compared with.
            comparison: of the two bags.
            factor: simulated time over wall time.
            pace: what of, in words.
        """
        setup = self.setup
        provenance = provenance_of(setup.files)
        return render_page(
            "rx90_emulator.demo",
            "report.html.j2",
            robot=setup.robot.model.name,
            provenance={getattr(setup.files, k).name: v for k, v in provenance.items()},
            run=self,
            factor=factor,
            pace=pace,
            baseline=baseline,
            limit=PATH_LIMIT,
            switched_off=SWITCHED_OFF,
            same=comparison.verdict is Verdict.SAME,
            topics=comparison.topics,
            friction=list(zip(setup.friction.names, setup.friction.elements, strict=True)),
            plots={
                "path": path_error(self.path, self.path_without),
                "tracking": tracking(self.joints, self.error),
                "friction": friction(self.friction),
            },
        )


START_TIME = 0.25
"""When the trajectory starts, s: late enough to arrive before it, whatever the machine does, because time
stands still until every process is there."""
_SERVICE_TIMEOUT = 60.0
_BAR = "{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}{postfix}]"


class Demonstration:
    """A run of the reference task in a folder of its own.

    Args:
        robot: the name or folder of the robot, for the processes.
        files: its files, and the task.
        pace: the real-time factor; 0 is as fast as it goes.
    """

    def __init__(self, robot: str, files: RobotFiles, pace: float) -> None:
        task_file = files.required("task")
        self._robot = ("-p", f"robot:={robot}")
        self._motion = ("--robot", robot, task_file, "--start-time", START_TIME)
        self._pace = pace
        self._setup = Setup.load(files)
        self._task = load_task(task_file)
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
        factor = self._run_processes(folder / "log", recorded)
        print("comparing the recorded run with the closed loop without ROS ...", flush=True)
        comparison = compare_bags(recorded, baseline)
        print(comparison_text(comparison))
        run = RunReport(recorded, self._setup, self._task, START_TIME)
        pace = f"paced to {self._pace:g}" if self._pace else "not paced"
        write_text(page, run.page(baseline, comparison, factor, f"real time, {pace}"))
        print(
            f"path error: worst {run.path.worst * 1e3:.4f} mm, "
            f"{run.path_without.worst * 1e3:.4f} mm {SWITCHED_OFF}; asked for: {PATH_LIMIT * 1e3:g} mm"
        )
        print(f"report: {page.resolve()}")
        if run.path.worst > PATH_LIMIT:
            print("rx90 demo: the path error is above what was asked for", file=sys.stderr)
        return run.path.worst <= PATH_LIMIT and comparison.verdict is Verdict.SAME

    def _run_processes(self, logs: Path, bag: Path) -> float:
        """Run the processes to the end of the task; return the real-time factor."""
        duration = START_TIME + self._plan.duration
        given = {
            "initial_position": self._plan.start_pose.tolist(),
            "duration": duration,
            "real_time_factor": self._pace,
            "paused": "true",
        }
        parameters = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
        print("starting simulation, controller, trajectory and recorder ...", flush=True)
        with ProcessGroup(logs) as group:
            recorder = group.start("recorder", executable("rx90 bag", "record", "--output", bag))
            simulation = group.start(
                "simulation", executable("rx90_sim", "--ros-args", *parameters, *self._robot)
            )
            group.start("controller", executable("rx90_controller", "--ros-args", *self._robot))
            line = group.start("trajectory", executable("rx90 line", *self._motion))
            recorder.wait_for("ready: all")
            line.expect_success()
            factor = _follow_clock(simulation, duration)
            simulation.expect_success()
            recorder.signal(signal.SIGINT)
            recorder.expect_success()
        return factor


def _follow_clock(process: ChildProcess, duration: float) -> float:
    """Let time run and draw a progress bar of simulated time until the simulation's process ends.

    Returns:
        The real-time factor from the first to the last time that was heard; 0 if there were no two.
    """
    # From the first time that is heard: before it, the nodes wait for those who listen.
    heard: list[tuple[float, float]] = []  # simulated, of the clock
    with (
        client_node("rx90_demo", _SERVICE_TIMEOUT, lambda _: None) as client,
        tqdm(total=duration, bar_format=_BAR, desc="reference task", disable=None) as bar,
    ):
        simulation = SimulationClient(client)
        simulation.pause(False)
        while process.returncode is None:
            client.spin()
            now = min(simulation.time, duration)
            if now > bar.n:
                heard.append((now, time.monotonic()))
                bar.update(now - bar.n)
    if len(heard) < 2:
        return 0.0
    simulated, elapsed = np.subtract(heard[-1], heard[0])
    return float(simulated / elapsed)


def path_error(recorded: PathAccuracy, without: PathAccuracy) -> figure:
    """Show the path error along the line as recorded, the one of the run with which it is compared, and the limit."""
    shown = chart(
        "", "distance along the line, mm", "path error, mm", y_range=DataRange1d(start=0.0)
    )
    shown.line(
        without.along * 1e3, without.perpendicular * 1e3, name=SWITCHED_OFF, color=COLOURS[1]
    )
    shown.line(
        recorded.along * 1e3, recorded.perpendicular * 1e3, name="recorded", color=COLOURS[0]
    )
    shown.hspan(
        [PATH_LIMIT * 1e3], name="asked for laser welding", line_color=INK, line_dash="dashed"
    )
    return shown


def tracking(joints: JointSeries, error: JointSeries) -> list[figure]:
    """Show the velocities of the joints, and their position errors."""
    velocities = chart("", "", "joint velocity, rad/s")
    errors = chart("", "", "position error, mrad")
    over_one_x([velocities, errors], "time, s")
    _draw(velocities, joints.time, joints.fields["velocity"], joints.names)
    _draw(errors, error.time, error.fields["position"] * 1e3, joints.names)
    return [velocities, errors]


def friction(elements: JointSeries) -> list[figure]:
    """Show the friction torques against time, and against velocity."""
    states = elements.fields
    over_time = chart("", "time, s", "friction torque, Nm")
    over_velocity = chart("", "input velocity, rad/s", "friction torque, Nm")
    _draw(over_time, elements.time, states["effort"], elements.names)
    for k, name in enumerate(elements.names):
        over_velocity.line(
            states["velocity"][:, k], states["effort"][:, k], name=name, color=COLOURS[k]
        )
    return [over_time, over_velocity]


def _draw(shown: figure, time: Array, values: Array, names: tuple[str, ...]) -> None:
    """Draw the columns of values, (n, k), over time, (n,)."""
    for k, name in enumerate(names):
        shown.line(time, values[:, k], name=name, color=COLOURS[k])
