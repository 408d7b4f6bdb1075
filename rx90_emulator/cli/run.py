"""Run a line or a trajectory through the closed loop without ROS and write the bag that the nodes would."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_emulator.cli.options import add_robot_arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(interrupted="nothing was written")
    motion = parser.add_mutually_exclusive_group()
    motion.add_argument("--task", default="task/reference_line.yaml", help="task file (%(default)s)")
    motion.add_argument(
        "--trajectory", type=Path, help="JointTrajectory in YAML, begun at rest in its first point, instead of a task"
    )
    parser.add_argument("--start-time", type=float, default=0.0, help="start of the trajectory, s (%(default)s)")
    parser.add_argument("--output", type=Path, help="bag folder to write; must not exist")
    parser.add_argument("--arrays", type=Path, help="NumPy file to write (.npz), names with units; must not exist")
    parser.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap", help="of the bag (%(default)s)")
    parser.add_argument(
        "--decimation", type=int, default=1, help="write every n-th message of the 1 kHz topics (%(default)s)"
    )
    parser.add_argument("--slow-only", action="store_true", help="leave the two 4 kHz topics out of the bag")
    parser.add_argument("--no-feed-forward", action="store_true", help="switch the feed-forward block off")
    parser.add_argument("--substeps", type=int, default=1, help="plant steps in a tick (%(default)s)")
    parser.add_argument("--base-rate", type=int, default=4000, help="Hz (%(default)s)")
    parser.add_argument("--position-rate", type=int, default=1000, help="Hz (%(default)s)")
    add_robot_arguments(parser)


def main(options: argparse.Namespace) -> None:
    """Simulate and write what was asked for.

    Raises:
        Rx90Error: for what cannot be done, before anything has been written.
    """
    from rx90_emulator.loop.job import run  # here, because --help must not wait for it

    run(options)
