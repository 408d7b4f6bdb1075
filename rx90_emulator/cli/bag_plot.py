"""Draw the joint states or temperatures of a bag, or of two bags and their difference: a page to zoom in, or a picture.

The suffix of --output says which: .html, .png, .svg or .pdf. Without options a page shows joint states, friction and
tracking error, as far as the bag has them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain
from rx90_common.process.files import write_text
from rx90_emulator.cli.options import place

HELP = "draw one bag, or two and their difference, as a page or a picture"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag: folder, .mcap, .db3 or ROS 1 .bag file")
    parser.add_argument("second", type=Path, nargs="?", metavar="BAG2", help="bag to draw over it")
    parser.add_argument("--signals", type=Path, metavar="FILE",
                        help="what the columns of a CSV, Parquet or NPZ table hold (the file named as the table, with "
                        ".yaml)")  # fmt: skip
    parser.add_argument("-o", "--output", type=place, metavar="FILE",
                        help=".html, .png, .svg or .pdf (the bag's name with .html, here)")  # fmt: skip
    parser.add_argument("--force", action="store_true", help="replace a file that exists")
    parser.add_argument("--topic", nargs="+", dest="topics", metavar="TOPIC",
                        help="topics of joint states or temperatures (joint_states; on a page friction, tracking "
                        "error, too)")  # fmt: skip
    parser.add_argument("--joint", nargs="+", dest="joints", metavar="JOINT", help="joints (all)")
    parser.add_argument("--align", metavar="start|trajectory|S",
                        help="moves the stamps of BAG2, as in compare (0)")  # fmt: skip


def main(args: argparse.Namespace) -> None:
    """Write the page or picture and say where it is.

    Raises:
        Rx90Error: if it cannot be done.
    """
    # Here, because --help must not wait for them.
    from rx90_common.bags.mapping import LogMapping
    from rx90_common.bags.plotting import bag_page, check_suffix, joined, picture_title, plot_bags, robots_text
    from rx90_common.report.picture import write_picture
    from rx90_emulator.cli.bag_compare import alignment
    from rx90_emulator.cli.progress import progress_bar

    if args.align is not None and args.second is None:
        raise ConfigError(f"--align {plain(args.align)} with one bag; accepted: with two")
    output: Path = args.output or place(f"{args.bag.resolve().name}.html")
    is_page = check_suffix(output)
    if output.exists() and not args.force:
        raise ConfigError(f"{plain(output)} exists; accepted: another name, or --force")
    paths = [args.bag] if args.second is None else [args.bag, args.second]
    align, most = alignment(args.align or "0"), 3 if is_page else 1
    mapping = None if args.signals is None else LogMapping.load(args.signals)
    with progress_bar("reading") as progress:
        plots = plot_bags(
            paths, topics=args.topics, joints=args.joints, align=align, most=most, progress=progress, mapping=mapping
        )
    if is_page:
        write_text(output, bag_page(paths, plots))
    else:
        write_picture(joined(plots), output, picture_title(paths, plots))
    if robots := robots_text(paths, plots):
        print(robots)
    print(f"{'page' if is_page else 'picture'}: {plain(output.resolve())}")
