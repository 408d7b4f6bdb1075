"""Show friction around sliding on a friction rig: loops, break-away, slow speeds, stick-slip, drift; choose its law."""

from __future__ import annotations

import argparse

from friction_bench.presliding import KINDS, USUAL_BLOCKS, USUAL_CYCLES
from rx90_common.base.share import PRESLIDING_RIG
from rx90_emulator.cli.options import new_folder, whole_number


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(interrupted="the rig is switched off", load="joint")
    parser.add_argument("--port", default="emulated", help="serial device, URL or 'emulated' (default)")
    parser.add_argument("--baud", type=whole_number, help="line rate (default: the rig file's)")
    parser.add_argument("--rig", default=PRESLIDING_RIG, help="rig file (default: %(default)s)")
    parser.add_argument(
        "--kinds", nargs="+", choices=KINDS, metavar="KIND",
        help=f"experiments after the ramps: {', '.join(KINDS)} (default: all)",
    )  # fmt: skip
    parser.add_argument("--blocks", type=whole_number, help=f"blocks of loops (default: {USUAL_BLOCKS})")
    parser.add_argument("--cycles", type=whole_number, help=f"small cycles of the drift (default: {USUAL_CYCLES})")
    parser.add_argument("--clear", action="store_true", help="clear the faults that the rig has latched, then begin")
    parser.add_argument("--seed", type=whole_number, help="of the emulated rig's noise (0)")
    parser.add_argument("--real-time", action="store_true", help="run the emulated rig in real time")
    parser.add_argument("--output", type=new_folder, default="out/presliding", help="new folder for bag and report")


def main(options: argparse.Namespace) -> int:
    """Run the experiments and write the report; 1 where the law cannot be told or a part carries nothing.

    Raises:
        Rx90Error: for what is refused; what has been measured until then stands in the folder.
    """
    from friction_bench.presliding.job import run  # here, because --help must not wait for it

    return run(options)
