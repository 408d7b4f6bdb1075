"""Check a controller of the arm: a battery of runs in lock-step, side by side with the CS7B, report and verdict."""

from __future__ import annotations

import argparse
import re
import shutil
import sys
from pathlib import Path

from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError
from rx90_common.base.quoting import one_line, plain, quoted
from rx90_emulator.cli.options import (
    CONTROLLER,
    add_node_arguments,
    add_robot_arguments,
    new_folder,
    node_of,
    progress_bar,
    stay_on_this_machine,
    whole_number,
)

_TIMEOUT = 30.0
_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_REPORT, _RESULT = "report.html", "result.json"
_EPILOG = """\
the controller is COMMAND, which is started anew for each case and gets what stands behind --ros-args, on a
ROS_DOMAIN_ID of its own unless one is set; without COMMAND it is the running node --node.
docs/howto/controller_check.md says more.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog = _EPILOG
    parser.set_defaults(interrupted="there is no report", ros_args=[])
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="COMMAND",
                        help="starts the controller, with its arguments; after all options")  # fmt: skip
    parser.add_argument("--case", action="append", dest="cases", metavar="NAME",
                        help="run this case alone; several times for several (all)")  # fmt: skip
    parser.add_argument("--set-points", metavar="TOPIC",
                        help="give set-points one by one, as JointState on this topic, 20 ms before their stamps, to a "
                        "controller that takes no trajectory on NODE/joint_trajectory")  # fmt: skip
    parser.add_argument("--command-interface", choices=("motor", "joint"), default="motor",
                        help="what the controller publishes: motor_commands or joint_commands "
                        "(%(default)s)")  # fmt: skip
    parser.add_argument("--command-rate", type=whole_number, metavar="HZ",
                        help="of joint_commands (the rate of the position loop)")  # fmt: skip
    parser.add_argument("--limits", type=Path, metavar="FILE", help="limits in YAML, instead of the usual ones")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    parser.add_argument("--output", type=new_folder, default="controller_check",
                        help="new folder for report, result and logs (%(default)s)")  # fmt: skip
    add_node_arguments(parser, _TIMEOUT)
    add_robot_arguments(parser)


def main(options: argparse.Namespace) -> int:
    """Return 0 where the controller keeps all limits, else 1.

    Raises:
        Rx90Error: for what cannot be done.
    """
    if options.command_interface == "motor" and options.command_rate is not None:
        raise ConfigError("--command-rate without --command-interface joint; accepted: with it, motor_commands have "
                          "the base rate")  # fmt: skip
    for name, given in (("node", options.node), ("set-points", options.set_points)):
        if given is not None and not _NAME.fullmatch(given):
            raise ConfigError(
                f"--{name} {quoted(given)}; accepted: a name such as my_controller or /cell/my_controller"
            )
    command = [*options.command, *options.ros_args]
    if command and shutil.which(command[0]) is None:
        raise ConfigError(f"COMMAND {quoted(command[0])}: no such program; accepted: one that starts a controller, or "
                          f"none for the running node --node ({CONTROLLER})")  # fmt: skip
    if command:
        stay_on_this_machine()
    # Here, because --help must not wait for them.
    from rx90_common.base.rates import ticks_per
    from rx90_common.description.robot_files import RobotFiles
    from rx90_common.exchange.ros_start import prepare
    from rx90_common.process.files import write_text
    from rx90_emulator.conformance.battery import CASES
    from rx90_emulator.conformance.quantities import CheckLimits
    from rx90_emulator.loop.setup import Setup

    prepare()
    from rx90_emulator.conformance.bench import Candidate
    from rx90_emulator.conformance.check import check_controller

    setup, limits = Setup.load(RobotFiles.of_options(options)), CheckLimits.load(options.limits)
    assert setup.files is not None
    for name in options.cases or ():
        if name not in CASES:
            raise ConfigError(f"--case {quoted(name)}; accepted: {', '.join(CASES)}")
    names = options.cases or CASES
    if options.cases is None and setup.files.tool is None:
        names = [name for name in CASES if not name.startswith("payload")]
        print("the arm carries no tool: the cases with another payload are left out")
    at_joints, rates = options.command_interface == "joint", setup.rates
    rate = (options.command_rate or rates.position_hz) if at_joints else rates.base_hz
    ticks, timeout = ticks_per("command_rate", rates.base_hz, rate), options.timeout or _TIMEOUT
    candidate = Candidate(command, node_of(options), options.set_points, at_joints, ticks, timeout)
    output = Path(options.output)
    output.mkdir(parents=True)
    options.interrupted += "; {output} has the logs of the controller"
    with progress_bar("check") as progress:
        result = check_controller(candidate, setup, names, limits, output, progress)
    write_text(output / _RESULT, result.json)
    write_text(output / _REPORT, result.page)
    print(result.json if options.json else f"{result.text}\nreport: {plain((output / _REPORT).resolve())}")
    for one in result.deciding:
        print(one_line(f"rx90_controller_check: {one.text}"), file=sys.stderr)
    return DONE if result.passed else VERDICT_NO
