"""The commands of the friction rig, real or emulated: its node and self-test, ramps, the emulator.

What has been measured until a refusal stands in the folder of results; `friction_ramp` ends with 1 where a load carries
no estimate.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from friction_bench.experiment.record import TEXT_KINDS, VELOCITIES
from rx90_common.base.errors import DONE, ConfigError
from rx90_common.base.quoting import plain
from rx90_common.base.share import SHIPPED_RIG, resolve_config
from rx90_common.process.interrupts import stop_request
from rx90_emulator.cli import node
from rx90_emulator.cli.options import (
    BAUD,
    FINITE,
    SEED,
    add_rig_arguments,
    add_robot_argument,
    add_verbs,
    whole_from,
)


def add_bench(parser: argparse.ArgumentParser) -> None:
    """Accept arguments for ROS, or the verb."""
    add_verbs(parser, ((_add_selftest, selftest, "test a rig, without questions, at rest"),), required=False)
    node.add_arguments(parser)
    parser.usage = f"{parser.usage}\n       {parser.prog} selftest [--port PORT] ..."


def bench(options: argparse.Namespace) -> int:
    """Run the node of the friction rig, real or emulated; or, without ROS, test a rig."""
    if options.verb is None:
        node.main(options)
        return DONE
    if options.ros_args:
        raise ConfigError(f"{plain(' '.join(options.ros_args))} with {options.verb}; accepted: with the node alone")
    return options.run(options)  # type: ignore[no-any-return]


def _add_selftest(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(interrupted="the torque is off")
    parser.add_argument("--port", default="emulated", help="serial device, URL or 'emulated' (default)")
    parser.add_argument("--baud", type=BAUD, help="line rate (the rig file's)")
    parser.add_argument("--rig", default=SHIPPED_RIG, metavar="FILE", help="rig file (%(default)s)")


def selftest(options: argparse.Namespace) -> int:
    """Test line, figures, stop, torque limit and watchdog of a rig, and print what was expected and found.

    Nobody need be there, and the shaft stays at rest. The exit code is 0 if all is as expected, 1 if something is not,
    3 if the rig does not answer.
    """
    from friction_bench.experiment.selftest import run  # here, because --help must not wait for it

    return run(options)


def add_ramp(parser: argparse.ArgumentParser) -> None:
    """Add the options of `friction_ramp`."""
    parser.add_argument(
        "--slopes", type=FINITE, nargs="+", metavar="M", help="slopes, Nm/s (default: by the first ramp)"
    )
    parser.add_argument("--repeats", type=whole_from(1, 1000), help="ramps of each slope (default: by the first ramp)")
    parser.add_argument("--end-torque", type=FINITE, help="end of each ramp, Nm at the motor")
    parser.add_argument(
        "--load", choices=("none", "joint", "both"), default="both", help="joint coupled? (default: %(default)s)"
    )
    parser.add_argument(
        "--source",
        action="store_true",
        help="the source's experiment on rig/source.yaml: no-load at its first slope, loaded at its second, "
        "and the source's evaluation beside this one's",
    )
    add_rig_arguments(parser, SHIPPED_RIG, "out/friction")
    parser.add_argument("--element", default="joint_6", help="friction element that the joint stands for")
    add_robot_argument(parser)
    files = parser.add_argument_group("old data instead of a rig")
    files.add_argument("--no-load-file", action="append", default=[], metavar="M:FILE", help="slope and file")
    files.add_argument("--loaded-file", action="append", default=[], metavar="M:FILE", help="slope and file")
    files.add_argument("--text", choices=TEXT_KINDS, help="files are plain text of this kind, not CSV")
    files.add_argument(
        "--velocity",
        choices=VELOCITIES,
        help="what --text velocity is: mean since the last reading, as pulses give it (default), or at the reading",
    )


def ramp(options: argparse.Namespace) -> int:
    """Measure Coulomb and viscous friction with torque ramps on a friction rig, or read old ramps."""
    from friction_bench.experiment.job import run  # here, because --help must not wait for it

    return run(options)


def add_emulator(parser: argparse.ArgumentParser) -> None:
    """Add the options of `friction_rig_emulator`."""
    parser.add_argument("--rig", default=SHIPPED_RIG, help="rig file (%(default)s)")
    parser.add_argument("--link", type=Path, help="symbolic link to make to the pseudo-terminal")
    parser.add_argument("--loaded", action="store_true", help="couple the revolute joint")
    parser.add_argument("--seed", type=SEED, default=0, help="of all noise (%(default)s)")


def emulator(options: argparse.Namespace) -> None:
    """Run an emulated friction rig, with the real firmware, behind a pseudo-terminal for any serial program."""
    stop = stop_request()
    from friction_bench.rig.emulated import EmulatedRig, PtyRig
    from friction_bench.rig.rig_file import load_rig

    rig = load_rig(resolve_config(options.rig))
    emulated = EmulatedRig(rig, options.seed)
    emulated.plant.load(options.loaded)
    pty_rig = PtyRig(emulated, options.link)
    print(f"emulated rig at {options.link or pty_rig.path}, {rig.baud} baud; Ctrl-C ends it", flush=True)
    stop.wait()
    pty_rig.close()
