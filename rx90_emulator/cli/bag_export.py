"""Write joint states and temperatures of a bag as tables for others: CSV, Parquet, or NPZ with names that MATLAB takes.

The suffix of --output says the format; without one it is a folder with a file for each topic. Every number keeps all
its bits: `rx90_bag import` makes an equal bag of exported CSV files.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, listed, plain
from rx90_emulator.cli.options import new_folder

HELP = "write a bag as CSV, Parquet or NPZ"
_KINDS = ("csv", "parquet", "npz")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag: folder, .mcap, .db3 or ROS 1 .bag file")
    parser.add_argument("-o", "--output", type=new_folder, required=True, metavar="FILE|FOLDER",
                        help="FILE.csv, FILE.parquet (one topic), FILE.npz, or a folder; must not exist")  # fmt: skip
    parser.add_argument("--topic", nargs="+", dest="topics", metavar="TOPIC",
                        help="topics of joint states or temperatures (all)")  # fmt: skip
    parser.add_argument("--format", choices=_KINDS, help=f"of the files in a folder ({_KINDS[0]})")


def main(args: argparse.Namespace) -> None:
    """Write the files and say what they hold.

    Raises:
        Rx90Error: if it cannot be done.
    """
    if args.format is not None and args.output.suffix.lower().removeprefix(".") in _KINDS:
        told = f"--format {args.format} with the file {plain(args.output)}"
        raise ConfigError(f"{told}; accepted: with a folder, for the suffix of a file says its format")
    # Here, because --help must not wait for them.
    from rx90_common.bags.exporting import export_bag
    from rx90_emulator.cli.progress import progress_bar

    with progress_bar("export") as progress:
        done = export_bag(
            args.bag, args.output, topics=args.topics, kind=f".{args.format or _KINDS[0]}", progress=progress
        )
    for topic, count in done.topics:
        print(f"{plain(topic)}: {counted(count, 'message')}")
    if done.left_out:
        print(f"left out, as they hold no joint states or temperatures: {listed(done.left_out)}")
    print(f"written: {listed(done.files)}")
