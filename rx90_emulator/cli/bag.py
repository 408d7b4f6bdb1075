"""Record, compare, draw, export, import and summarise bags."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rx90_common.bags.tolerance import GRAMMAR, Tolerances
from rx90_common.bags.topics import SUITE_TOPICS
from rx90_common.base.errors import BagError, ConfigError, check_replaced
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.ros_start import prepare
from rx90_common.process.interrupts import stop_request
from rx90_emulator.cli.options import (
    add_robot_arguments,
    add_verbs,
    check_apart,
    check_needs,
    new_folder,
    place,
)

if TYPE_CHECKING:
    from rx90_common.bags.mapping import LogMapping
    from rx90_common.bags.recorder.stream import TopicCount

_MAX_STAMP = 4_294_967_296  # s: stamps count so far, and two of them do not overflow 64 bits of ns
_KINDS = ("csv", "parquet", "npz")
# What several verbs have in common.
_BAG: dict[str, Any] = {"metavar": "BAG", "help": "bag: folder, .mcap, .db3 or ROS 1 .bag file"}
_TOPIC: dict[str, Any] = {"nargs": "+", "dest": "topics", "metavar": "TOPIC"}
_NOTHING_WRITTEN = "nothing was written"
_TIP_FILES = ("urdf", "tool", "drives")  # files of a robot that say where a bag's tip was

_MAPPING = """\
a signal map (docs/howto/bags.md says more):
  time: {column: 1, unit: s}                # or, without a column of times: rate: 5000
  names: [shoulder, elbow]
  position: {columns: [2, 3], unit: deg}
  velocity: {columns: [dq1, dq2], unit: rad/s}
  effort: {columns: [i1, i2], unit: A}
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add a parser for each verb, whose help is what its function says of itself."""
    parser.set_defaults(ros_args=[])  # `ros2 run` and launch files append them
    add_verbs(parser, _VERBS)


def _add_signals(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--signals", type=Path, metavar="FILE",
                        help="what the columns of a CSV, Parquet or NPZ table hold (the file named as the table, with "
                        ".yaml)")  # fmt: skip


def _signals(args: argparse.Namespace) -> LogMapping | None:
    from rx90_common.bags.mapping import LogMapping

    return None if args.signals is None else LogMapping.load(args.signals)


def _add_record(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "topics", nargs="*", metavar="TOPIC",
        help=f"topics to record; each must get a message (default: {' '.join(SUITE_TOPICS)}, as far as they do)",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", type=new_folder, required=True, metavar="FOLDER", help="bag to make; must not exist"
    )


def _record(args: argparse.Namespace) -> int:
    """Record topics of a running system to a new bag, and prove that nothing was lost."""
    # Before the slow imports: a signal at any moment from here on still leaves a valid bag.
    stop = stop_request()

    from rx90_common.bags.writing import BagWriter

    prepare()
    from rx90_common.bags.recorder.recording import record

    counts = record(args.topics or SUITE_TOPICS, args.ros_args, lambda: BagWriter(args.output), stop)
    return _report(counts, args.output, requested=bool(args.topics))


def _report(counts: Sequence[TopicCount], output: Path, *, requested: bool) -> int:
    """Print what was recorded, and what not; return the exit code. Requested topics may not stay empty."""
    repeated = sum(count.repeated for count in counts)
    received = sum(count.received for count in counts)
    empty = [count.topic for count in counts if not count.received]
    left_out = f"; left out: {counted(repeated, 'repetition')} of the sample before" if repeated else ""
    topics = counted(len(counts) - len(empty), "topic")
    print(f"recorded {counted(received - repeated, 'message')} of {topics} to {plain(output)}{left_out}")
    failures = []
    if empty and (requested or not received):
        part = "not" if received else "nothing"
        failures.append(f"{part} recorded: no message came on {listed(empty)}")
    for count in counts:
        writers = "; ".join(f"{w.lost} of {w.received + w.lost}" for w in count.writers)
        if count.lost:
            failures.append(f"lost: {counted(count.lost, 'message')} of {count.topic} (by publisher: {writers})")
        if count.refused:
            failures.append(f"not recorded: {counted(count.refused, 'publisher')} of {count.topic}, whose quality of "
                            "service does not fit the first one's")  # fmt: skip
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


def _add_compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bag_a", **_BAG | {"metavar": "A"})
    parser.add_argument("bag_b", metavar="B", help="bag to compare it with")
    _add_signals(parser)
    parser.add_argument(
        "--tolerance", action="append", default=[], metavar=GRAMMAR,
        help="in rad, rad/s or Nm; the last one that fits decides; default 0: equal bits",
    )  # fmt: skip
    parser.add_argument("--topics", nargs="+", metavar="TOPIC", help="compare only these")
    parser.add_argument("--from", dest="start", metavar="S", help="leave out stamps before this time in s")
    parser.add_argument("--to", dest="end", metavar="S", help="leave out stamps after this time in s")
    parser.add_argument(
        "--common-range", action="store_true", help="stamps before or after what both bags have make no difference"
    )
    parser.add_argument(
        "--align", default="0", metavar="start|trajectory|S",
        help="move the stamps of B: so that both bags begin together, so that their last trajectories do, or by a time "
        "in s (%(default)s)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.add_argument("--path-error", action="store_true", help="print, too, how far each tip is from the path of "
                        "its set-points, across and along it, and the tool from its orientation")  # fmt: skip
    add_robot_arguments(parser, *_TIP_FILES)


def _compare(args: argparse.Namespace) -> int:
    """Compare the joint states of two bags and judge: exit 0 same, 1 differs, 2 cannot be compared.

    Messages are paired by header.stamp and joints by name. Of several messages with one stamp, exact repetitions
    count once, and different ones are paired in their order. Stamps, joints and arrays that only one bag has make a
    difference. Bags of runs that began at other times are aligned with --align.
    """
    from rx90_common.bags.comparison import Scope, compare_bags
    from rx90_common.bags.tables import comparison_json, comparison_text

    check_needs(args, ("robot", *_TIP_FILES), ("path_error",))
    check_apart(args, ("json",), "path_error", "one of them")
    scope = Scope(
        topics=tuple(dict.fromkeys(args.topics)) if args.topics else None,
        start_ns=None if args.start is None else _time("--from", args.start),
        end_ns=None if args.end is None else _time("--to", args.end),
        common_range=args.common_range,
        align=alignment(args.align),
    )
    comparison = compare_bags(args.bag_a, args.bag_b, Tolerances(*args.tolerance), scope, _signals(args))
    paths = _path_errors(args) if args.path_error else []
    print(comparison_json(comparison) if args.json else comparison_text(comparison))
    print("".join(f"{line}\n" for line in paths), end="")
    return int(comparison.verdict)


def _path_errors(args: argparse.Namespace) -> list[str]:
    """Return a line for each bag: its path errors, by the set-points in it."""
    from rx90_common.description.robot import load_robot
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.identification.validation.recorded_path import recorded_accuracy

    files = RobotFiles.of_options(args)
    lines = []
    robot = load_robot(files.urdf, files.tool)
    for bag in (args.bag_a, args.bag_b):
        accuracy = recorded_accuracy(Path(bag), robot, files, args.signals)
        lines.append(f"{plain(bag)}: {accuracy.words if accuracy else 'no path error: it holds no set-points'}")
    return lines


def alignment(text: str) -> int | str:
    """Return what --align says, as `Scope` takes it."""
    from rx90_common.bags.recorded import START, TRAJECTORY

    return text if text in (START, TRAJECTORY) else _time("--align", text, f"{START}, {TRAJECTORY}, or a time in s")


def _time(option: str, text: str, accepted: str = "a time in s, e.g. 1.25") -> int:
    """Return a time in ns without the detour over floating point, which spoils stamps of the wall clock."""
    try:
        if abs(time := Decimal(text)) <= _MAX_STAMP:  # raises for what is no number
            return int(time * NANOSECONDS)
    except (InvalidOperation, ValueError):
        pass
    raise BagError(f"{option} is {quoted(text)}; accepted: {accepted}, up to {_MAX_STAMP:,} s")


def _add_plot(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(interrupted=_NOTHING_WRITTEN)
    parser.add_argument("bag", type=Path, **_BAG)
    parser.add_argument("second", type=Path, nargs="?", metavar="BAG2", help="bag to draw over it")
    _add_signals(parser)
    parser.add_argument("-o", "--output", type=place, metavar="FILE",
                        help=".html, .png, .svg or .pdf (the bag's name with .html, here)")  # fmt: skip
    parser.add_argument("--force", action="store_true", help="replace a file that exists")
    parser.add_argument("--topic", **_TOPIC,
                        help="topics of joint states (joint_states, friction, tracking error)")  # fmt: skip
    parser.add_argument("--joint", nargs="+", dest="joints", metavar="JOINT", help="joints (all)")
    parser.add_argument("--align", metavar="start|trajectory|S",
                        help="moves the stamps of BAG2, as in compare (0)")  # fmt: skip


def _plot(args: argparse.Namespace) -> None:
    """Draw joint states of a bag, or of two bags and their difference: a page to zoom in, or a picture.

    The suffix of --output says which: .html, .png, .svg or .pdf. Without options it shows joint states, friction and
    tracking error, as far as the bag has them.
    """
    from rx90_common.bags.plot_files import write_plots
    from rx90_common.bags.plotting import plot_bags

    if args.align is not None and args.second is None:
        raise ConfigError(f"--align {plain(args.align)} with one bag; accepted: with two")
    output: Path = args.output or place(f"{args.bag.resolve().name}.html")
    check_replaced(output, force=args.force)
    paths = [args.bag] if args.second is None else [args.bag, args.second]
    align = alignment(args.align or "0")
    write_plots(paths, plot_bags(paths, args.topics, args.joints, align, _signals(args)), output)
    print(f"plot: {plain(output.resolve())}")


def _add_export(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(interrupted=_NOTHING_WRITTEN)
    parser.add_argument("bag", type=Path, **_BAG)
    _add_signals(parser)
    parser.add_argument("-o", "--output", type=new_folder, required=True, metavar="FILE|FOLDER",
                        help="FILE.csv, FILE.parquet (one topic), FILE.npz, or a folder; must not exist")  # fmt: skip
    parser.add_argument("--topic", **_TOPIC,
                        help="topics of joint states (all)")  # fmt: skip
    parser.add_argument("--format", choices=_KINDS, help=f"of the files in a folder ({_KINDS[0]})")


def _export(args: argparse.Namespace) -> None:
    """Write joint states of a bag as tables: CSV, Parquet, or NPZ with names that MATLAB takes.

    The suffix of --output says the format; without one it is a folder with a file for each topic. Every number keeps
    all its bits: `rx90_bag import` makes an equal bag of exported CSV files.
    """
    if args.format is not None and args.output.suffix.lower().removeprefix(".") in _KINDS:
        given = f"--format {args.format} with the file {plain(args.output)}"
        raise ConfigError(f"{given}; accepted: with a folder, for the suffix of a file says its format")
    from rx90_common.bags.exporting import export_bag
    from rx90_emulator.cli.options import progress_bar

    kind = f".{args.format or _KINDS[0]}"
    mapping = _signals(args)
    with progress_bar("export") as progress:
        topics = export_bag(args.bag, args.output, topics=args.topics, kind=kind, progress=progress, mapping=mapping)
    for topic, count in topics.items():
        print(f"{plain(topic)}: {counted(count, 'message')}")
    print(f"written: {plain(args.output)}")


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _MAPPING
    parser.set_defaults(interrupted=_NOTHING_WRITTEN)
    parser.add_argument("log", type=Path, metavar="LOG", help="log to read, or a folder with those of an export")
    parser.add_argument("bag", type=new_folder, metavar="BAG", help="bag to make; must not exist")
    _add_signals(parser)


def _import(args: argparse.Namespace) -> None:
    """Make a bag of joint states from a log in columns, CSV or separated by blanks; a signal map says what they hold.

    Of a folder that `rx90_bag export` has written it makes the bag again.
    """
    from rx90_common.bags.logs import read_log
    from rx90_common.bags.writing import write_joint_states

    folder = args.log.is_dir()
    logs = sorted(args.log.glob("*.csv")) if folder else [args.log]
    if not logs or (folder and args.signals):
        raise ConfigError(f"{plain(args.log)}: accepted: a folder with CSV files, each with its signal map, or a log")
    mapping = _signals(args)
    tables = [read_log(log, mapping) for log in logs]
    write_joint_states(args.bag, tables)
    for series in tables:
        print(f"{plain(series.topic)}: {counted(len(series.stamp_ns), 'message')}")
    print(f"bag: {plain(args.bag)}")


def _add_info(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bag", **_BAG)
    _add_signals(parser)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def _info(options: argparse.Namespace) -> None:
    """Summarise a bag: topics, counts, rates, times, and gaps between stamps."""
    from rx90_common.bags.summary import summarise
    from rx90_common.bags.tables import summary_json, summary_text

    summary = summarise(options.bag, _signals(options))
    print(summary_json(summary) if options.json else summary_text(summary))


_VERBS = (
    (_add_record, _record, "record topics to a new bag; a lost message is a non-zero exit, and so is an empty bag"),
    (_add_compare, _compare, "compare two bags; exit 0 same, 1 differs, 2 cannot be compared"),
    (_add_plot, _plot, "draw one bag, or two and their difference, as a page or a picture"),
    (_add_export, _export, "write a bag as CSV, Parquet or NPZ"),
    (_add_import, _import, "make a bag from a CSV log; a file says what its columns hold"),
    (_add_info, _info, "summarise a bag"),
)
