"""Check a controller of the arm: a battery of runs in lock-step, side by side with the CS7B, report and verdict."""

from __future__ import annotations

import argparse
import re
import shutil
import sys
from argparse import ArgumentParser, Namespace

from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError
from rx90_common.base.quoting import one_line, plain, quoted
from rx90_emulator.cli.options import (
    CONTROLLER,
    add_node_arguments,
    add_output,
    add_robot_arguments,
    new_folder,
    progress_bar,
    setup_of,
    stay_on_this_machine,
    whole_number,
)

_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_EPILOG = """\
the controller is COMMAND, which is started anew for each case and gets what stands behind --ros-args, on a
ROS_DOMAIN_ID of its own unless one is set; without COMMAND it is the running node --node.
docs/howto/controller_check.md says more.
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog = _EPILOG
    parser.set_defaults(
        interrupted="there is no report; {output} has the logs of the controller", ros_args=[]
    )
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="COMMAND",
                        help="starts the controller, with its arguments; after all options")  # fmt: skip
    parser.add_argument("--case", action="append", dest="cases", metavar="NAME",
                        help="run this case alone; several times for several (all)")  # fmt: skip
    parser.add_argument("--set-points", metavar="TOPIC",
                        help="give set-points one by one, as JointState on this topic, 20 ms before their stamps, to a "
                        "controller that takes no trajectory on NODE/joint_trajectory")  # fmt: skip
    parser.add_argument("--joint-commands", type=whole_number, metavar="HZ",
                        help="the controller publishes joint_commands, at this rate (motor_commands, at the base "
                        "rate)")  # fmt: skip
    about = "new folder for report, result and logs (%(default)s)"
    add_output(parser, new_folder, about, default="controller_check", metavar="FOLDER")
    add_node_arguments(parser)
    add_robot_arguments(parser)


def main(options: Namespace) -> int:
    """Return 0 where the controller keeps all limits, else 1."""
    at_joints = options.joint_commands is not None
    if options.set_points is not None and not _NAME.fullmatch(options.set_points):
        raise ConfigError(
            f"--set-points {quoted(options.set_points)}; accepted: a topic such as /cell/set_points"
        )
    command = [*options.command, *options.ros_args]
    if command and shutil.which(command[0]) is None:
        raise ConfigError(f"COMMAND {quoted(command[0])}: no such program; accepted: one that starts a controller, or "
                          f"none for the running node --node ({CONTROLLER})")  # fmt: skip
    if command:
        stay_on_this_machine()
    # Here, because --help must not wait for them.
    from rx90_common.base.rates import ticks_per
    from rx90_common.exchange.ros_start import prepare
    from rx90_common.process.files import write_text
    from rx90_emulator.conformance.battery import CASES

    prepare()
    from rx90_emulator.conformance.bench import Candidate
    from rx90_emulator.conformance.check import check_controller

    setup = setup_of(options)
    names = options.cases or list(CASES)
    for name in names:
        if name not in CASES:
            raise ConfigError(f"--case {quoted(name)}; accepted: {', '.join(CASES)}")
    rate = setup.rates.base_hz if options.joint_commands is None else options.joint_commands
    ticks_per_command = ticks_per("--joint-commands", setup.rates.base_hz, rate)
    candidate = Candidate(
        command, options.node, options.set_points, at_joints, ticks_per_command, options.timeout
    )
    with progress_bar("check") as progress:
        result = check_controller(candidate, setup, names, options.output, progress)
    write_text(options.output / "result.json", result.json)
    write_text(options.output / "report.html", result.page)
    print(f"{result.text}\nreport: {plain(options.output / 'report.html')}")
    for line in result.deciding:
        print(one_line(f"rx90 check: {line}"), file=sys.stderr)
    return VERDICT_NO if result.deciding else DONE
