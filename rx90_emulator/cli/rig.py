"""Torque ramps on a friction rig, real or emulated, its self-test, and the emulated rig behind a serial line.

What has been measured until a refusal stands in the folder of results.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rx90_common.base.share import resolve_config
from rx90_common.process.interrupts import stop_request
from rx90_emulator.cli.options import (
    FINITE,
    add_output,
    add_rig_argument,
    add_robot_argument,
    new_folder,
    whole_from,
)

_SEED = whole_from(0, 2**31 - 1)


def _add_selftest(parser: ArgumentParser) -> None:
    parser.set_defaults(interrupted="the torque is off")
    _add_line(parser)
    add_rig_argument(parser)


def _selftest(options: Namespace) -> int:
    """Test line, figures, stop, torque limit and watchdog of a rig, and print what was expected and found.

    Nobody need be there, and the shaft stays at rest. The exit code is 0 if all is as expected, 1 if something is not,
    3 if the rig does not answer.
    """
    from friction_bench.experiment.selftest import run  # here, because --help must not wait for it

    return run(options)


def _add_ramp(parser: ArgumentParser) -> None:
    parser.set_defaults(files=False, source=False)
    parser.add_argument(
        "--slopes", type=FINITE, nargs="+", metavar="M", help="slopes, Nm/s (by the first ramp)"
    )
    _add_measuring(parser)


def _add_measuring(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--repeats", type=whole_from(1, 1000), metavar="N", help="ramps of each slope"
    )
    parser.add_argument(
        "--end-torque", type=FINITE, metavar="NM", help="end of each ramp, Nm at the motor"
    )
    parser.add_argument(
        "--load",
        choices=("none", "joint", "both"),
        default="both",
        help="joint coupled? (%(default)s)",
    )
    parser.set_defaults(interrupted="the rig is switched off")
    _add_line(parser)
    add_rig_argument(parser)
    parser.add_argument(
        "--clear", action="store_true", help="clear the faults that the rig has latched, then begin"
    )
    _add_result(parser, "bag and report")


def _add_line(parser: ArgumentParser) -> None:
    parser.add_argument("--port", default="emulated", help="serial device, URL, 'emulated' (default), or with the "
                        "seed of its noise 'emulated:SEED'")  # fmt: skip


def _add_result(parser: ArgumentParser, what: str) -> None:
    about = f"new folder for {what} (%(default)s)"
    add_output(parser, new_folder, about, default="out/friction", metavar="FOLDER")
    parser.add_argument(
        "--element",
        default="joint_6",
        help="friction element that the joint stands for (%(default)s)",
    )
    add_robot_argument(parser)


def _ramp(options: Namespace) -> int:
    """Measure Coulomb and viscous friction with torque ramps; 1 where a load carries no estimate."""
    from friction_bench.experiment.job import run  # here, because --help must not wait for it

    return run(options)


def _add_source(parser: ArgumentParser) -> None:
    parser.set_defaults(files=False, source=True, slopes=None)
    _add_measuring(parser)


def _source(options: Namespace) -> int:
    """Repeat the source's experiment, on rig/source.yaml: no-load at its first slope, loaded at its second.

    The source's evaluation stands beside this one's.
    """
    return _ramp(options)


def _add_read(parser: ArgumentParser) -> None:
    parser.set_defaults(**_NO_MEASURING, files=True, source=False)
    for option in ("--no-load-file", "--loaded-file"):
        parser.add_argument(
            option, action="append", default=[], metavar="M:FILE", help="slope and file"
        )
    parser.add_argument("--text", choices=("increments", "counts", "velocity", "instantaneous-velocity"),
                        help="files are plain text of this kind, not CSV; velocity is the mean since the last reading, "
                        "as pulses give it")  # fmt: skip
    add_rig_argument(parser)
    _add_result(parser, "the report")


def _read(options: Namespace) -> int:
    """Read old ramps from files, and evaluate them as new ones are."""
    return _ramp(options)


def _add_emulator(parser: ArgumentParser) -> None:
    add_rig_argument(parser)
    parser.add_argument("--link", type=Path, help="symbolic link to make to the pseudo-terminal")
    parser.add_argument("--loaded", action="store_true", help="couple the revolute joint")
    parser.add_argument(
        "--seed", type=_SEED, default=0, metavar="N", help="of the emulated rig's noise (0)"
    )


def _emulator(options: Namespace) -> None:
    """Run an emulated friction rig, with the real firmware, behind a pseudo-terminal for any serial program."""
    stop = stop_request()
    from friction_bench.rig.emulated import EmulatedRig, PtyRig
    from friction_bench.rig.rig_file import load_rig

    rig = load_rig(resolve_config(options.rig))
    emulated = EmulatedRig(rig, options.seed)
    emulated.plant.load(options.loaded)
    pty_rig = PtyRig(emulated, options.link)
    print(
        f"emulated rig at {options.link or pty_rig.path}, {rig.baud} baud; Ctrl-C ends it",
        flush=True,
    )
    stop.wait()
    pty_rig.close()


_NO_MEASURING = {
    "slopes": None,
    "repeats": None,
    "end_torque": None,
    "load": "both",
    "port": "emulated",
    "clear": False,
}
"""Options of a measurement, of which there is none where old ramps are read."""

SUBCOMMANDS = (
    (_add_ramp, _ramp, "measure friction with torque ramps"),
    (_add_source, _source, "repeat the source's experiment"),
    (_add_read, _read, "evaluate old ramps from files"),
    (_add_emulator, _emulator, "run an emulated rig behind a pseudo-terminal"),
    (_add_selftest, _selftest, "test a rig, without questions, at rest"),
)
