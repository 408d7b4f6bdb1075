"""Move the tool along a straight line with a trapezoidal velocity profile."""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import rx90_emulator as rx
from rx90_common.base.errors import LineError
from rx90_emulator.cli.options import (
    FINITE,
    add_node_arguments,
    add_output,
    add_rate,
    add_robot_arguments,
    add_start_time,
    place,
    progress_bar,
    setup_of,
)

if TYPE_CHECKING:
    from rx90_common.description.robot import RobotModel
    from rx90_controller.lines.plan import LinePlan
    from rx90_controller.lines.task import TipTask
    from rx90_controller.trajectory import JointLimits
    from rx90_controller.trajectory.correction import Correction

_EPILOG = """\
Positions are those of the tool centre point in base_link; the tool's z axis is the beam, and rpy 0 180 0
points it down. example: rx90 line --start 0.6 -0.2 0.2 --end 0.6 0.2 0.2 --speed 0.1 --approach
"""
# s, without --timeout: for nodes, and more for one that compiles when it starts
_TIMEOUT = 30.0
_STARTING = 120.0
_PLAIN_OPTIONS = ("start", "end", "speed", "acceleration", "start_posture")
"""Options that go into the task as they are."""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog = _EPILOG
    parser.formatter_class = RawDescriptionHelpFormatter
    parser.add_argument("task", nargs="?", metavar="TASK",
                        help="task file (the robot's task.yaml); what is given beside it wins over it, and start and "
                        "end together make a line of their own")  # fmt: skip
    motion = parser.add_argument_group("line")
    xyz = ("X", "Y", "Z")
    rpy = ("ROLL", "PITCH", "YAW")
    motion.add_argument("--start", type=FINITE, nargs=3, metavar=xyz, help="m")
    motion.add_argument("--end", type=FINITE, nargs=3, metavar=xyz, help="m")
    motion.add_argument("--speed", type=FINITE, help="m/s (0.1)")
    motion.add_argument("--acceleration", type=FINITE, help="m/s^2 (1)")
    motion.add_argument(
        "--tool-rpy", type=FINITE, nargs=3, metavar=rpy, help="deg, fixed axes (0 180 0: down)"
    )
    motion.add_argument("--start-posture", type=FINITE, nargs="+", metavar="RAD",
                         help="of an arm without a spherical wrist: joint positions near which it starts (middle of "
                         "the ranges); without --start the line starts there, with the tool as it then is")  # fmt: skip
    add_sending(parser)


def add_sending(parser: ArgumentParser) -> None:
    """Add the options of the robot, and of what becomes of a plan."""
    add_robot_arguments(parser, "urdf", "tool", "controller")
    parser.set_defaults(ros_args=[])
    send = parser.add_argument_group("sending")
    add_rate(send)
    add_node_arguments(send)
    send.set_defaults(timeout=None)
    add_start_time(send, "0: now")
    send.add_argument(
        "--approach", action="store_true", help="first move to the start, straight in the joints"
    )
    send.add_argument(
        "--correction",
        metavar="FILE",
        help="correction file of this path, as rx90 correct learns it",
    )
    send.add_argument("--dry-run", action="store_true", help="plan and print, send nothing")
    about = (
        "write the trajectory as a YAML message, or in FILE.csv set-points, with --correction corrected ones: s, "
        "joints in deg, tool in mm and deg"
    )
    add_output(send, place, about, metavar="FILE")


def main(options: Namespace) -> None:
    """Plan the line, and send it."""
    plan_and_send(options, _task)


def plan_and_send(
    options: Namespace,
    task_of: Callable[[Namespace, rx.RobotFiles, RobotModel], TipTask],
) -> None:
    """Plan what `task_of` reads for an arm, show it, write it where asked for, and send it, except with --dry-run."""
    # Here, because --help must not wait for them.
    from rx90_common.description.robot import load_robot
    from rx90_controller.law.parameters import load_controller
    from rx90_controller.lines.plan import check_plan, describe_line, plan_line

    files = rx.RobotFiles.of_options(options)
    robot = load_robot(files.urdf, files.tool)
    period = 1.0 / options.rate
    task = task_of(options, files, robot)
    limits = load_controller(files.controller).limits(robot)
    plan = plan_line(robot, task, period, limits.acceleration)
    _say(describe_line(plan))
    check_plan(plan, limits, period, plan.start_pose)
    correction = None
    if options.correction is not None:
        correction = rx.load_correction(options.correction).fitting(setup_of(options), plan)
    if options.output is not None:
        from rx90_emulator.loop.trajectory_file import write_trajectory

        table = options.output.suffix.lower() == ".csv"
        write_trajectory(options.output, robot, plan.points, period, correction)
        without = (
            ""
            if table or correction is None
            else ", without the correction; set-points with it: FILE.csv"
        )
        _say(f"written to {options.output}{without}")
    if not options.dry_run:
        _send(plan, limits, correction, options)


def _task(options: Namespace, files: rx.RobotFiles, robot: RobotModel) -> rx.LineTask:
    """Return the task of the file, or of start and end alone, with the options laid over it."""
    from rx90_controller.lines.postures import task_from

    alone = options.task is None and options.end is not None
    if alone and options.start is not None:
        task = rx.LineTask(tuple(options.start), tuple(options.end))
    elif alone and options.start_posture is not None:
        task = task_from(robot, options.start_posture, options.end)
    else:
        task = rx.load_task(files.required("task"))
    given: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value
        for key in _PLAIN_OPTIONS
        if (value := getattr(options, key)) is not None
    }
    if options.tool_rpy is not None:
        orientation = tuple(math.radians(angle) for angle in options.tool_rpy)
        given["start_rpy"] = orientation
        given["end_rpy"] = orientation
    return replace(task, **given)


def _send(
    plan: LinePlan, limits: JointLimits, correction: Correction | None, options: Namespace
) -> None:
    if not 0.0 <= options.start_time < 2.0**31:
        raise LineError(
            f"the start time is {options.start_time:g} s; accepted: a number >= 0, 0 for now"
        )
    from rx90_common.exchange.ros_start import prepare

    prepare()
    # Here, because planning alone needs no ROS.
    from rx90_common.exchange.client_node import client_node
    from rx90_controller.node.trajectory_client import deliver

    with client_node("rx90_line", options.timeout or _TIMEOUT, _say, options.ros_args) as client:
        wait = deliver(
            client, plan, options.node, limits, 1.0 / options.rate, options.approach,
            start_time=options.start_time, correction=correction, starting=0.0 if options.timeout else _STARTING,
        )  # fmt: skip
        if wait is None:
            return
        options.interrupted = (
            "the controller goes on with the motion; a trajectory without points stops it"
        )
        with progress_bar("motion") as progress:
            end = wait(progress)
        _say(f"arrived: the motion ended at {end:.3f} s")


def _say(text: str) -> None:
    print(text, flush=True)
