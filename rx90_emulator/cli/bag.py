"""Record, compare, draw, export, import and summarise bags."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rx90_emulator as rx
from rx90_common.bags.tolerance import GRAMMAR
from rx90_common.bags.topics import SUITE_TOPICS
from rx90_common.base.errors import BagError, ConfigError, check_replaced
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.ros_start import prepare
from rx90_common.process.interrupts import stop_request
from rx90_emulator.cli.options import (
    add_force,
    add_joints_argument,
    add_output,
    add_robot_arguments,
    add_signals_argument,
    add_verbs,
    new_folder,
    place,
)

if TYPE_CHECKING:
    from rx90_common.bags.mapping import LogMapping
    from rx90_common.bags.recorder.stream import TopicCount

_MAX_STAMP = 4_294_967_296  # s: stamps count so far, and two of them do not overflow 64 bits of ns
# What several verbs have in common.
_BAG: dict[str, Any] = {"metavar": "BAG", "help": "bag: folder, .mcap, .db3 or ROS 1 .bag file"}
_NOTHING_WRITTEN = "nothing was written"

_MAPPING = """\
a signal map (docs/howto/bags.md says more):
  time: {column: 1, unit: s}                # or, without a column of times: rate: 5000
  names: [shoulder, elbow]
  position: {columns: [2, 3], unit: deg}
  velocity: {columns: [dq1, dq2], unit: rad/s}
  effort: {columns: [i1, i2], unit: A}
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add a parser for each verb, whose help is what its function says of itself."""
    parser.set_defaults(ros_args=[])  # `ros2 run` and launch files append them
    add_verbs(parser, _VERBS)


def _add_topics(parser: ArgumentParser, default: str) -> None:
    parser.add_argument(
        "--topic",
        nargs="+",
        dest="topics",
        metavar="TOPIC",
        help=f"topics of joint states ({default})",
    )


def _add_signals(parser: ArgumentParser) -> None:
    add_signals_argument(parser, "what the columns of a CSV, Parquet or NPZ table hold")


def _signals(args: Namespace) -> LogMapping | None:
    from rx90_common.bags.mapping import LogMapping

    return None if args.signals is None else LogMapping.load(args.signals)


def _add_record(parser: ArgumentParser) -> None:
    parser.add_argument(
        "topics", nargs="*", metavar="TOPIC",
        help=f"topics to record; each must get a message (default: {' '.join(SUITE_TOPICS)}, as far as they do)",
    )  # fmt: skip
    add_output(parser, new_folder, "bag to make; must not exist", metavar="FOLDER", required=True)


def _record(args: Namespace) -> int:
    """Record topics of a running system to a new bag, and prove that nothing was lost."""
    # Before the slow imports: a signal at any moment from here on still leaves a valid bag.
    stop = stop_request()

    from rx90_common.bags.writing import BagWriter

    prepare()
    from rx90_common.bags.recorder.recording import record

    counts = record(
        args.topics or SUITE_TOPICS, args.ros_args, lambda: BagWriter(args.output), stop
    )
    return _report(counts, args.output, requested=bool(args.topics))


def _report(counts: Sequence[TopicCount], output: Path, *, requested: bool) -> int:
    """Print what was recorded, and what not; return the exit code. Requested topics may not stay empty."""
    repeated = sum(count.repeated for count in counts)
    received = sum(count.received for count in counts)
    empty = [count.topic for count in counts if not count.received]
    left_out = (
        f"; left out: {counted(repeated, 'repetition')} of the sample before" if repeated else ""
    )
    topics = counted(len(counts) - len(empty), "topic")
    print(
        f"recorded {counted(received - repeated, 'message')} of {topics} to {plain(output)}{left_out}"
    )
    failures = []
    if empty and (requested or not received):
        part = "not" if received else "nothing"
        failures.append(f"{part} recorded: no message came on {listed(empty)}")
    for count in counts:
        writers = "; ".join(f"{w.lost} of {w.received + w.lost}" for w in count.writers)
        if count.lost:
            failures.append(
                f"lost: {counted(count.lost, 'message')} of {count.topic} (by publisher: {writers})"
            )
        if count.refused:
            failures.append(f"not recorded: {counted(count.refused, 'publisher')} of {count.topic}, whose quality of "
                            "service does not fit the first one's")  # fmt: skip
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


def _add_compare(parser: ArgumentParser) -> None:
    parser.add_argument("bag_a", **_BAG | {"metavar": "A"})
    parser.add_argument("bag_b", metavar="B", help="bag to compare it with")
    _add_signals(parser)
    parser.add_argument(
        "--tolerance", action="append", default=[], metavar=GRAMMAR,
        help="in rad, rad/s or Nm; the last one that fits decides; default 0: equal bits",
    )  # fmt: skip
    _add_topics(parser, "all")
    parser.add_argument(
        "--common-range",
        action="store_true",
        help="stamps before or after what both bags have make no difference",
    )
    parser.add_argument(
        "--align", default="0", metavar="start|trajectory|S",
        help="move the stamps of B: so that both bags begin together, so that their last trajectories do, or by a time "
        "in s (%(default)s)",
    )  # fmt: skip


def _compare(args: Namespace) -> int:
    """Compare the joint states of two bags and judge: exit 0 same, 1 differs, 2 cannot be compared.

    Messages are paired by header.stamp and joints by name. Of several messages with one stamp, exact repetitions
    count once, and different ones are paired in their order. Stamps, joints and arrays that only one bag has make a
    difference. Bags of runs that began at other times are aligned with --align.
    """
    scope = rx.Scope(
        topics=tuple(dict.fromkeys(args.topics)) if args.topics else None,
        common_range=args.common_range,
        align=alignment(args.align),
    )
    comparison = rx.compare_bags(
        args.bag_a, args.bag_b, rx.Tolerances(*args.tolerance), scope, _signals(args)
    )
    print(rx.comparison_text(comparison))
    return int(comparison.verdict)


def _add_path(parser: ArgumentParser) -> None:
    parser.add_argument("bags", type=Path, **_BAG | {"nargs": "+"})
    _add_signals(parser)
    add_robot_arguments(parser, "urdf", "tool", "drives")


def _path(args: Namespace) -> None:
    """Print how far the tip was from the path of the bag's set-points, across and along it, and its orientation."""
    from rx90_common.description.robot import load_robot
    from rx90_emulator.measured_runs.recorded_path import recorded_accuracy

    files = rx.RobotFiles.of_options(args)
    robot = load_robot(files.urdf, files.tool)
    signals = _signals(args)
    for bag in args.bags:
        line, approach = recorded_accuracy(bag, robot, files, args.signals)
        if line is not None:
            print(f"{plain(bag)}: {line.words}")
        if approach is not None:
            print(f"{plain(bag)}: approach: {approach.words}")
        if line is None and approach is None:
            print(f"{plain(bag)}: no path error: it holds no set-points")
        _say_cut(bag, signals)


def alignment(text: str) -> int | str:
    """Return what --align says, as `Scope` takes it; times in ns, exactly, which floating point would spoil."""
    from rx90_common.bags.recorded import START, TRAJECTORY

    if text in (START, TRAJECTORY):
        return text
    try:
        if abs(time := Decimal(text)) <= _MAX_STAMP:  # raises for what is no number
            return int(time * NANOSECONDS)
    except (InvalidOperation, ValueError):
        pass
    accepted = f"{START}, {TRAJECTORY}, or a time in s, up to {_MAX_STAMP:,} s"
    raise BagError(f"--align is {quoted(text)}; accepted: {accepted}")


def _add_plot(parser: ArgumentParser) -> None:
    parser.set_defaults(interrupted=_NOTHING_WRITTEN)
    parser.add_argument("bag", type=Path, **_BAG)
    parser.add_argument("second", type=Path, nargs="?", metavar="BAG2", help="bag to draw over it")
    _add_signals(parser)
    add_output(parser, place, "page (the bag's name with .html, here)", metavar="FILE")
    add_force(parser)
    _add_topics(parser, "joint_states, friction, tracking error")
    add_joints_argument(parser, "joints (all)")
    parser.add_argument("--align", default="0", metavar="start|trajectory|S",
                        help="moves the stamps of BAG2, as in compare (%(default)s)")  # fmt: skip


def _plot(args: Namespace) -> None:
    """Draw joint states of a bag, or of two bags over each other: a page to zoom in.

    Without options it shows joint states, friction and tracking error, as far as the bag has them.
    """
    from rx90_common.bags.plotting import plot_bags, plot_page
    from rx90_common.process.files import write_text

    output: Path = args.output or place(f"{args.bag.resolve().name}.html")
    if output.suffix.lower() != ".html":
        raise ConfigError(f"--output {plain(output)}; accepted: a page, .html")
    check_replaced(output, force=args.force)
    paths = [args.bag] if args.second is None else [args.bag, args.second]
    drawn = plot_bags(paths, args.topics, args.joints, alignment(args.align), _signals(args))
    write_text(output, plot_page(paths, drawn))
    print(f"plot: {plain(output.resolve())}")


def _add_export(parser: ArgumentParser) -> None:
    parser.set_defaults(interrupted=_NOTHING_WRITTEN)
    parser.add_argument("bag", type=Path, **_BAG)
    _add_signals(parser)
    text = "FILE.csv, .parquet or .npz of one topic, or a folder; must not exist"
    add_output(parser, new_folder, text, metavar="FILE|FOLDER", required=True)
    _add_topics(parser, "all")


def _export(args: Namespace) -> None:
    """Write joint states of a bag as tables: CSV, Parquet, or NPZ with names that MATLAB takes.

    The suffix of --output says the format; without one it is a folder with a CSV file for each topic. Every number
    keeps all its bits: `rx90 bag import` makes an equal bag of exported CSV files.
    """
    from rx90_common.bags.exporting import export_bag
    from rx90_emulator.cli.options import progress_bar

    mapping = _signals(args)
    with progress_bar("export") as progress:
        topics = export_bag(
            args.bag, args.output, topics=args.topics, progress=progress, mapping=mapping
        )
    for topic, count in topics.items():
        print(f"{plain(topic)}: {counted(count, 'message')}")
    print(f"written: {plain(args.output)}")


def _add_import(parser: ArgumentParser) -> None:
    parser.formatter_class = RawDescriptionHelpFormatter
    parser.epilog = _MAPPING
    parser.set_defaults(interrupted=_NOTHING_WRITTEN)
    parser.add_argument("log", type=Path, metavar="LOG", help="log to read")
    parser.add_argument("bag", type=new_folder, metavar="BAG", help="bag to make; must not exist")
    _add_signals(parser)


def _import(args: Namespace) -> None:
    """Make a bag of joint states from a log in columns, whose signal map says what they hold."""
    from rx90_common.bags.logs import read_log

    log = read_log(args.log, _signals(args))
    rx.write_joint_states(args.bag, log)
    for series in log:
        print(f"{plain(series.topic)}: {counted(len(series.stamp_ns), 'message')}")
    print(f"bag: {plain(args.bag)}")


def _add_info(parser: ArgumentParser) -> None:
    parser.add_argument("bag", **_BAG)
    _add_signals(parser)


def _info(options: Namespace) -> None:
    """Summarise a bag: topics, counts, rates, times, and gaps between stamps."""
    from rx90_common.bags.summary import summarise
    from rx90_common.bags.tables import summary_text

    signals = _signals(options)
    print(summary_text(summarise(options.bag, signals)))
    _say_cut(options.bag, signals)


def _say_cut(bag: Path | str, mapping: LogMapping | None) -> None:
    """Print that a recording was ended too early, if it was."""
    from rx90_emulator.loop.recorded_setup import ends_in_motion

    if ends_in_motion(bag, mapping):
        print(f"{plain(bag)}: the recording ends while the set-points still move")


_VERBS = (
    (
        _add_record,
        _record,
        "record topics to a new bag; a lost message is a non-zero exit, and so is an empty bag",
    ),
    (_add_compare, _compare, "compare two bags; exit 0 same, 1 differs, 2 cannot be compared"),
    (_add_path, _path, "print how far the tip was from the path of its set-points"),
    (_add_plot, _plot, "draw one bag, or two over each other, as a page"),
    (_add_export, _export, "write a bag as CSV, Parquet or NPZ"),
    (_add_import, _import, "make a bag from a CSV log; a file says what its columns hold"),
    (_add_info, _info, "summarise a bag"),
)
