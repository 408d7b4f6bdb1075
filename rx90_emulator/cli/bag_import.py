"""Make a bag of joint states from a log in columns: CSV, or separated by blanks; a mapping file says what they hold.

Of a folder that `rx90_bag export` has written it makes the bag again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, plain
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
                        help="log to read, of several the rows belong together; or an exported folder")  # fmt: skip
    parser.add_argument("bag", type=new_folder, metavar="BAG", help="bag to make; must not exist")
    parser.add_argument("--mapping", "--signals", type=Path, metavar="FILE",
                        help="what the columns hold (the file named as the log, with .yaml)")  # fmt: skip
    parser.add_argument("--skip-corrupt", action="store_true",
                        help="leave out damaged rows and say which; otherwise they are refused")  # fmt: skip
    parser.add_argument("-s", "--storage", choices=("mcap", "sqlite3"), default="mcap", help="storage (default: mcap)")


def main(args: argparse.Namespace) -> None:
    """Make the bag and say what was read.

    Raises:
        Rx90Error: if it cannot be done.
    """
    # Here, because --help must not wait for them.
    from rx90_common.bags.logs import corrupt_text, exported_logs, import_logs
    from rx90_common.bags.mapping import LogMapping
    from rx90_emulator.cli.progress import progress_bar

    if len(args.logs) == 1 and args.logs[0].is_dir():
        if args.mapping is not None:
            raise ConfigError(f"--mapping {plain(args.mapping)}: a folder has its own; accepted: none of the two")
        logs = exported_logs(args.logs[0])
    else:
        logs = [(args.logs, LogMapping.load(_mapping_file(args)))]
    with progress_bar("import") as progress:
        done = import_logs(logs, args.bag, skip_corrupt=args.skip_corrupt, storage=args.storage, progress=progress)
    for one, (_, mapping) in zip(done, logs, strict=True):
        if not mapping.exact:
            print(one.text)
            continue
        for series in one.series:
            print(
                f"{plain(series.topic)}: {counted(len(series.names), 'joint')}, {counted(series.messages, 'message')}"
            )
        if one.corrupt:
            print(f"{plain(one.paths[0])}: left out: {corrupt_text(one.corrupt)}")
    print(f"bag: {plain(args.bag)}")


def _mapping_file(args: argparse.Namespace) -> Path:
    if args.mapping is not None:
        return Path(args.mapping)
    beside = Path(args.logs[0]).with_suffix(".yaml")
    if not beside.is_file():
        raise ConfigError(
            f"--mapping is missing, and there is no {plain(beside)}; accepted: a file that says what the columns hold"
        )
    return beside
