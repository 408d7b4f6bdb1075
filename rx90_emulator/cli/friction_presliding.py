"""Show friction around sliding on a friction rig: loops, break-away, slow speeds, stick-slip, drift; choose its law."""

from __future__ import annotations

import argparse

from friction_bench.presliding import KINDS, USUAL_BLOCKS, USUAL_CYCLES
from rx90_common.base.share import PRESLIDING_RIG
from rx90_emulator.cli.options import add_rig_arguments, whole_from


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(load="joint")
    parser.add_argument(
        "--kinds", nargs="+", choices=KINDS, metavar="KIND",
        help=f"experiments after the ramps: {', '.join(KINDS)} (default: all)",
    )  # fmt: skip
    parser.add_argument("--blocks", type=whole_from(6, 100), help=f"blocks of loops (default: {USUAL_BLOCKS})")
    parser.add_argument(
        "--cycles", type=whole_from(100, 100_000), help=f"small cycles of the drift (default: {USUAL_CYCLES})"
    )
    add_rig_arguments(parser, PRESLIDING_RIG, "out/presliding")


def main(options: argparse.Namespace) -> int:
    """Run the experiments and write the report; 1 where the law cannot be told or a part carries nothing.

    Raises:
        Rx90Error: for what is refused; what has been measured until then stands in the folder.
    """
    from friction_bench.presliding.job import run  # here, because --help must not wait for it

    return run(options)
