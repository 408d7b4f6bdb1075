"""Move the tool along a straight line with a trapezoidal velocity profile."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.errors import LineError
from rx90_common.description.branch import SHOULDERS, SIGNS
from rx90_emulator.cli.options import number

_EPILOG = """\
Positions are those of the tool centre point in base_link; the tool's z axis is the beam, and rpy 0 180 0
points it down. example: rx90_line --start 0.6 -0.2 0.2 --end 0.6 0.2 0.2 --speed 0.1 --approach
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog, parser.formatter_class = _EPILOG, argparse.RawDescriptionHelpFormatter
    parser.set_defaults(ros_args=[])
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
    robot.add_argument(
        "--set-point-rate",
        type=number("a positive number", lambda value: value > 0.0),
        default=1000.0,
        metavar="HZ",
        help="Hz (1000)",
    )
    send = parser.add_argument_group("sending")
    send.add_argument("--controller", default="rx90_controller", help="name of the node (rx90_controller)")
    send.add_argument("--start-time", type=float, default=0.0, metavar="S", help="start time, s; 0: now")
    send.add_argument("--approach", action="store_true", help="first move to the start, straight in the joints")
    send.add_argument("--approach-speed", type=float, default=0.25, help="share of the joint speeds (0.25)")
    send.add_argument("--approach-acceleration", type=float, default=2.0, help="rad/s^2 (2)")
    send.add_argument("--timeout", type=float, default=30.0, metavar="S", help="s to wait for the nodes (30)")
    send.add_argument("--dry-run", action="store_true", help="plan and print, send nothing")
    send.add_argument("--output", type=Path, metavar="FILE", help="write the trajectory as a YAML message")


def main(options: argparse.Namespace) -> None:
    """Plan the line, show it, and send it unless told otherwise.

    Raises:
        Rx90Error: if the line is refused; as an ExchangeError if it could not be delivered.
    """
    if options.from_file is None and (options.start is None or options.end is None):
        raise LineError("a line needs --start and --end, or --from-file")
    from rx90_emulator.cli.line_job import run  # here, because --help must not wait for it

    run(options)
