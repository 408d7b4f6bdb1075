"""`rx90_line`: plan a straight line of the tool and send it to the controller."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from rx90_common.base.errors import ExchangeError, Rx90Error
from rx90_common.description.branch import SHOULDERS, SIGNS

REFUSED, NOT_DELIVERED, INTERRUPTED = 1, 3, 130
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


def _run(argv: list[str]) -> int:
    parser = _parser()
    options = parser.parse_args(_without_ros_arguments(argv))
    if not (math.isfinite(options.set_point_rate) and options.set_point_rate > 0.0):
        parser.error(f"--set-point-rate is {options.set_point_rate:g}; accepted: a number > 0 Hz")
    if options.from_file is None and (options.start is None or options.end is None):
        parser.error("a line needs --start and --end, or --from-file")
    from rx90_emulator.cli.line_job import run  # here, because --help must not wait for it

    run(options, argv)
    return 0


def _without_ros_arguments(argv: list[str]) -> list[str]:
    if "--ros-args" not in argv:
        return argv
    from rx90_common.exchange.environment import prepare  # planning alone needs no ROS

    prepare()
    from rx90_common.exchange.ros_start import without_ros_args

    return without_ros_args(argv)


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
