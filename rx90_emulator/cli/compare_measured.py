"""A measured bag against the closed loop without ROS along the same set-points: torques, positions, a verdict."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rx90_common.base.errors import DONE, VERDICT_NO
from rx90_common.base.quoting import one_line
from rx90_emulator.cli.options import POSITIVE, add_message_arguments, add_record_arguments, add_robot_arguments, place
from rx90_emulator.identification.options import MeasuredLayout, MeasuredTolerances

_EPILOG = """\
set-points are those of the bag (rx90_controller/reference), else its measured path, smoothed without delay. Arms of
another structure: rx90_identify --friction FILE --validation BAG --urdf URDF. docs/howto/measured_path.md says more.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog = _EPILOG
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("bag", type=Path, metavar="BAG", help="measured: folder, .mcap, .db3 or ROS 1 .bag file")
    parser.add_argument("--report", type=place, metavar="FILE", help="report to write (.html)")
    parser.add_argument("--force", action="store_true", help="replace a report that exists")
    parser.add_argument("--bandwidth", type=POSITIVE, metavar="HZ",
                        help="of the measured path as set-points; torques and positions are compared below a third of "
                        "it (from the data)")  # fmt: skip
    limits = MeasuredTolerances()
    parser.add_argument("--torque-tolerance", type=POSITIVE, default=limits.torque, metavar="SHARE",
                        help="RMS difference over RMS torque, of each joint (%(default)s)")  # fmt: skip
    parser.add_argument("--total-torque-tolerance", type=POSITIVE, default=limits.total_torque, metavar="SHARE",
                        help="the same of all joints together (%(default)s)")  # fmt: skip
    parser.add_argument("--position-tolerance", type=POSITIVE, default=limits.position, metavar="RAD",
                        help="largest difference of a joint's position, rad (%(default)s)")  # fmt: skip
    add_robot_arguments(parser)
    layout = parser.add_argument_group("what the bag holds", "by default motor_states or joint_states as here")
    add_message_arguments(
        layout, topic="motor_states, else joint_states", names="as here", coupling="the robot's wrist"
    )
    add_record_arguments(layout)


def main(options: argparse.Namespace) -> int:
    """Return 0 where measured and simulated run agree, else 1.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.identification.job import run_comparison

    layout = MeasuredLayout(**{name: getattr(options, name) for name in MeasuredLayout.__dataclass_fields__})
    tolerances = MeasuredTolerances(
        options.torque_tolerance, options.total_torque_tolerance, options.position_tolerance
    )
    files = RobotFiles.of_options(options)
    if run_comparison(
        options.bag, files, layout, tolerances, options.bandwidth, options.report, force=options.force
    ):  # fmt: skip
        return DONE
    print(one_line(f"rx90_compare_measured: {options.bag} and the simulation do not agree"), file=sys.stderr)
    return VERDICT_NO
