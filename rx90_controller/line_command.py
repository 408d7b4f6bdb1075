"""`rx90_line`: plan a straight line of the tool and send it to the controller."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rx90_common.errors import ExchangeError, Rx90Error
from rx90_common.interrupts import interrupts_later
from rx90_common.share import resolve_config
from rx90_controller.line import LinePlan, plan_line, stamped_points
from rx90_controller.line_task import DEFAULT_BRANCH, LineTask, load_task
from rx90_description.inverse import SHOULDERS, SIGNS, Branch
from rx90_description.robot import load_robot

REFUSED, NOT_DELIVERED, INTERRUPTED = 1, 3, 130
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

_EPILOG = """\
exit status: 0 sent (or planned, with --dry-run), 1 refused, 2 wrong usage, 3 not delivered, 130 interrupted.
Positions are those of the tool centre point in base_link; the tool's z axis is the beam, and rpy 0 180 0
points it down. example: rx90_line --start 0.6 -0.2 0.2 --end 0.6 0.2 0.2 --speed 0.1 --approach
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rx90_line",
        description="Move the tool along a straight line with a trapezoidal velocity profile.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    line = parser.add_argument_group("line")
    xyz, rpy = ("X", "Y", "Z"), ("ROLL", "PITCH", "YAW")
    line.add_argument("--from-file", metavar="TASK", help="task file; options given beside it win over it")
    line.add_argument("--start", type=float, nargs=3, metavar=xyz, help="m")
    line.add_argument("--end", type=float, nargs=3, metavar=xyz, help="m")
    line.add_argument("--speed", type=float, help="m/s (0.1)")
    line.add_argument("--acceleration", type=float, help="m/s^2 (1)")
    line.add_argument("--tool-rpy", type=float, nargs=3, metavar=rpy, help="deg, fixed axes (0 180 0: down)")
    line.add_argument("--end-tool-rpy", type=float, nargs=3, metavar=rpy, help="deg, if it turns on the way")
    line.add_argument("--rest-before", type=float, metavar="S", help="s at rest before the line (0.5)")
    line.add_argument("--rest-after", type=float, metavar="S", help="s at rest after it (0.5)")
    posture = parser.add_argument_group("posture")
    posture.add_argument("--shoulder", choices=SHOULDERS)
    posture.add_argument("--elbow", choices=SIGNS, help="sign of joint 3")
    posture.add_argument("--wrist", choices=SIGNS, help="sign of joint 5")
    posture.add_argument(
        "--singularity-margin", type=float, metavar="M", help="closest to a singularity, 0.001 to 1 (0.05)"
    )
    robot = parser.add_argument_group("robot")
    robot.add_argument("--urdf", default="robot/rx90b.urdf", help="URDF (the shipped one)")
    robot.add_argument("--tool", default="robot/tool_laser_head.yaml", help="tool file (laser head), or 'none'")
    robot.add_argument("--set-point-rate", type=float, default=1000.0, metavar="HZ", help="Hz (1000)")
    send = parser.add_argument_group("sending")
    send.add_argument("--controller", default="rx90_controller", help="name of the node (rx90_controller)")
    send.add_argument("--start-time", type=float, default=0.0, metavar="S", help="start time, s; 0: now")
    send.add_argument("--approach", action="store_true", help="first move to the start, straight in the joints")
    send.add_argument("--approach-speed", type=float, default=0.25, help="share of the joint speeds (0.25)")
    send.add_argument("--approach-acceleration", type=float, default=2.0, help="rad/s^2 (2)")
    send.add_argument("--timeout", type=float, default=30.0, metavar="S", help="s to wait for the nodes (30)")
    send.add_argument("--dry-run", action="store_true", help="plan and print, send nothing")
    send.add_argument("--output", type=Path, metavar="FILE", help="write the trajectory as a YAML message")
    return parser


def _radians(degrees: Sequence[float]) -> tuple[float, ...]:
    return tuple(math.radians(angle) for angle in degrees)


def _task(parser: argparse.ArgumentParser, options: argparse.Namespace) -> LineTask:
    """Return the task of the file with the options laid over it, or of the options alone."""
    base = None if options.from_file is None else load_task(resolve_config(options.from_file))
    if base is None and (options.start is None or options.end is None):
        parser.error("a line needs --start and --end, or --from-file")
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
        for point in stamped_points(plan)
    ]
    message = {"joint_names": list(plan.joint_names), "points": points}
    try:
        file.write_text(yaml.safe_dump(message, sort_keys=False, default_flow_style=None), encoding="utf-8")
    except OSError as error:
        raise Rx90Error(f"{file}: cannot be written ({error.strerror})") from error


def _run(argv: list[str]) -> int:
    parser = _parser()
    options = parser.parse_args(_without_ros_arguments(argv))
    if not (math.isfinite(options.set_point_rate) and options.set_point_rate > 0.0):
        parser.error(f"--set-point-rate is {options.set_point_rate:g}; accepted: a number > 0 Hz")
    task = _task(parser, options)
    tool = None if options.tool == "none" else resolve_config(options.tool)
    plan = plan_line(load_robot(resolve_config(options.urdf), tool), task, 1.0 / options.set_point_rate)
    _say(summary(plan))
    if options.output is not None:
        write_message(plan, options.output)
        _say(f"written to {options.output}")
    if not options.dry_run:
        _send(plan, options, argv)
    return 0


def _without_ros_arguments(argv: list[str]) -> list[str]:
    if "--ros-args" not in argv:
        return argv
    from rx90_exchange.environment import prepare  # planning alone needs no ROS

    prepare()
    from rx90_exchange.ros_start import without_ros_args

    return without_ros_args(argv)


def _send(plan: LinePlan, options: argparse.Namespace, argv: list[str]) -> None:
    from rx90_exchange.environment import prepare

    prepare()
    # Here, because planning alone needs no ROS.
    from rclpy.utilities import try_shutdown

    from rx90_controller.line_publish import Approach, Delivery, deliver
    from rx90_exchange.ros_start import start_ros

    approach = Approach(options.approach_speed, options.approach_acceleration) if options.approach else None
    delivery = Delivery(options.controller, options.start_time, options.timeout, approach)
    with interrupts_later() as check_interrupt:
        start_ros(argv)
        try:
            deliver(plan, delivery, _say, check_interrupt)
        finally:
            try_shutdown()


def _say(text: str) -> None:
    print(text, flush=True)


def main(args: Sequence[str] | None = None) -> int:
    """Run `rx90_line` and return its exit status."""
    argv = list(sys.argv[1:] if args is None else args)
    try:
        return _run(argv)
    except KeyboardInterrupt:
        print("rx90_line: interrupted", file=sys.stderr)
        return INTERRUPTED
    except Rx90Error as error:
        print(f"rx90_line: {error}", file=sys.stderr)
        return NOT_DELIVERED if isinstance(error, ExchangeError) else REFUSED


if __name__ == "__main__":
    sys.exit(main())
