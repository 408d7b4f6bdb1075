"""Make a bag of joint states from a log in columns: CSV, or separated by blanks; a mapping file says what they hold."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_emulator.cli.options import new_folder

HELP = "make a bag from a CSV log; a file says what its columns hold"
EPILOG = """\
a mapping file (docs/howto/bags.md says more):
  time: {column: 1, unit: s}                # or, without a column of times: rate: 5000
  topics:
    joint_states:
      names: [shoulder, elbow]
      position: {columns: [2, 3], unit: deg}
      velocity: {columns: [dq1, dq2], unit: rad/s}
      effort: {columns: [i1, i2], unit: A}
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.formatter_class, parser.epilog = argparse.RawDescriptionHelpFormatter, EPILOG
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG",
                        help="log to read; of several the rows belong together, one by one")  # fmt: skip
    parser.add_argument("bag", type=new_folder, metavar="BAG", help="bag to make; must not exist")
    parser.add_argument("--mapping", type=Path, required=True, metavar="FILE", help="what the columns hold (.yaml)")
    parser.add_argument("--skip-corrupt", action="store_true",
                        help="leave out damaged rows and say which; otherwise they are refused")  # fmt: skip
    parser.add_argument("-s", "--storage", choices=("mcap", "sqlite3"), default="mcap", help="storage (default: mcap)")


def main(args: argparse.Namespace) -> None:
    """Make the bag and say what was read.

    Raises:
        Rx90Error: if it cannot be done.
    """
    # Here, because --help must not wait for them.
    from rx90_common.bags.importing.importing import import_logs
    from rx90_common.bags.importing.mapping import LogMapping

    mapping = LogMapping.load(args.mapping)
    done = import_logs(args.logs, args.bag, mapping, skip_corrupt=args.skip_corrupt, storage=args.storage)
    print(f"{done.text}\nbag: {args.bag}")
