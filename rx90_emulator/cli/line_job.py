"""What `rx90_line` does, apart from its options: imported once these are understood, for it takes a second."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.config import yaml_text
from rx90_common.base.errors import write_error
from rx90_common.base.share import resolve_config
from rx90_common.description.branch import Branch
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.law.parameters import load_controller
from rx90_controller.lines.plan import LinePlan, plan_line
from rx90_controller.lines.task import DEFAULT_BRANCH, LineTask, load_task
from rx90_controller.trajectory.message import stamped_points

_TOOL_DOWN = (0.0, 180.0, 0.0)
# Options that go into the task as they are.
_PLAIN_OPTIONS = (
    "start",
    "end",
    "speed",
    "acceleration",
    "rest_before",
    "rest_after",
    "singularity_margin",
)


def run(options: argparse.Namespace) -> None:
    """Plan the line, show it, and send it unless told otherwise.

    Raises:
        Rx90Error: if the line is refused; as an ExchangeError if it could not be delivered.
    """
    task = _task(options)
    tool = None if options.tool == "none" else resolve_config(options.tool)
    plan = plan_line(load_robot(resolve_config(options.urdf), tool), task, 1.0 / options.set_point_rate)
    _say(summary(plan))
    if options.output is not None:
        write_message(plan, options.output)
        _say(f"written to {options.output}")
    if not options.dry_run:
        _send(plan, options)


def _radians(degrees: Sequence[float]) -> tuple[float, ...]:
    return tuple(math.radians(angle) for angle in degrees)


def _task(options: argparse.Namespace) -> LineTask:
    """Return the task of the file with the options laid over it, or of the options alone."""
    base = None if options.from_file is None else load_task(resolve_config(options.from_file))
    given: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value
        for key in _PLAIN_OPTIONS
        if (value := getattr(options, key)) is not None
    }
    if options.tool_rpy is not None:
        given["start_rpy"] = given["end_rpy"] = _radians(options.tool_rpy)
    if options.end_tool_rpy is not None:
        given["end_rpy"] = _radians(options.end_tool_rpy)
    branch = base.branch if base else DEFAULT_BRANCH
    given["branch"] = Branch(
        options.shoulder or branch.shoulder, options.elbow or branch.elbow, options.wrist or branch.wrist
    )
    if base is not None:
        return replace(base, **given)
    down = _radians(_TOOL_DOWN)
    usual: dict[str, Any] = {"speed": 0.1, "acceleration": 1.0, "start_rpy": down, "end_rpy": down}
    return LineTask(**(usual | given))


def summary(plan: LinePlan) -> str:
    """Return a table of the plan for a person."""
    task, profile = plan.task, plan.task.profile()
    robot = plan.path.robot
    begin, end = plan.motion
    degrees = np.degrees
    lines = [
        f"line      {task.length:.4f} m at {profile.peak_speed:.4g} m/s, {task.acceleration:.4g} m/s^2",
        f"time      {plan.duration:.3f} s, moving from {begin:.3f} s to {end:.3f} s",
        f"knots     {len(plan.times)}, tip error between them {plan.tip_error * 1e6:.3g} um",
        f"posture   {task.branch}",
    ]
    lines += [
        f"margin    {kind} {margin:.3f} at {at:.3f} m (accepted: >= {task.singularity_margin:g})"
        for kind, (margin, at) in plan.path.margins.items()
    ]
    lines.append(f"{'joint':<10}{'start':>9}{'lowest':>9}{'highest':>9} deg{'peak':>9} deg/s{'of limit':>10}")
    peak = np.abs(plan.velocity).max(axis=0)
    columns = (plan.start_pose, plan.position.min(axis=0), plan.position.max(axis=0), peak)
    share = peak / robot.max_velocity
    for name, *values, part in zip(plan.joint_names, *(degrees(c) for c in columns), share, strict=True):
        start, low, high, fast = values
        lines.append(f"{name:<10}{start:9.2f}{low:9.2f}{high:9.2f}    {fast:9.2f}      {part:10.1%}")
    return "\n".join(lines)


def write_message(plan: LinePlan, file: Path) -> None:
    """Write the trajectory as the YAML of a trajectory_msgs/JointTrajectory, as `ros2 topic pub` takes it.

    Raises:
        Rx90Error: if the file cannot be written.
    """
    points = [
        {
            "positions": point.position,
            "velocities": point.velocity,
            "accelerations": point.acceleration,
            "time_from_start": {"sec": point.sec, "nanosec": point.nanosec},
        }
        for point in stamped_points(plan.points)
    ]
    message = {"joint_names": list(plan.joint_names), "points": points}
    try:
        file.write_text(yaml_text(message), encoding="utf-8")
    except OSError as error:
        raise write_error(file, error) from error


def _send(plan: LinePlan, options: argparse.Namespace) -> None:
    from rx90_common.exchange.environment import prepare

    prepare()
    # Here, because planning alone needs no ROS.
    from rx90_common.exchange.client_node import client_node
    from rx90_controller.node.trajectory_client import Approach, Delivery, deliver

    approach = Approach(options.approach_speed, options.approach_acceleration) if options.approach else None
    tolerance = load_controller(RobotFiles().controller).start_tolerance
    delivery = Delivery(options.controller, options.start_time, tolerance, approach)
    with client_node("rx90_line", options.timeout, _say, options.ros_args) as client:
        deliver(client, plan, delivery)


def _say(text: str) -> None:
    print(text, flush=True)
