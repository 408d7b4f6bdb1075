"""Record topics of a running system to a new bag, and prove that nothing was lost."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rx90_common.bags.topics import SUITE_TOPICS
from rx90_common.base.quoting import listed, plain
from rx90_common.exchange.ros_start import prepare
from rx90_common.process.interrupts import stop_request
from rx90_common.process.threads import be_nice, run_on
from rx90_emulator.cli.options import new_folder, whole_number

if TYPE_CHECKING:
    from rx90_common.bags.recorder.recording import TopicCount

HELP = "record topics to a new bag; a lost message is a non-zero exit, and so is an empty bag"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument(
        "topics", nargs="*", default=list(SUITE_TOPICS), metavar="TOPIC",
        help=f"topics to record (default: {' '.join(SUITE_TOPICS)})",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", type=new_folder, required=True, metavar="FOLDER", help="bag to make; must not exist"
    )
    parser.add_argument("-s", "--storage", choices=("mcap", "sqlite3"), default="mcap", help="storage (default: mcap)")
    parser.add_argument("--nice", type=whole_number, metavar="N", help="niceness: above 0 others come first")
    parser.add_argument("--cpus", metavar="LIST", help="processors to run on, as in 0,2-3")


def main(args: argparse.Namespace) -> int:
    """Record until Ctrl-C or SIGTERM; return 0 when something was recorded and nothing lost, and 1 otherwise.

    Raises:
        BagError: if the bag cannot be made or a topic cannot be recorded.
        BagWriteError: if the bag cannot be written on.
        ConfigError: for a niceness or processors that cannot be had.
    """
    # Before the slow imports: a signal at any moment from here on still leaves a valid bag.
    stop = stop_request()
    if args.nice is not None:
        be_nice(args.nice)
    if args.cpus is not None:
        run_on(args.cpus)

    from rx90_common.bags.writing import BagWriter

    prepare()
    from rx90_common.bags.recorder.recording import Recorder, StatusLine

    with StatusLine() as status:
        recorder = Recorder(args.topics, args.ros_args, status)
        counts = recorder.run(lambda: BagWriter(args.output, args.storage), stop)
    return _report(args.topics, counts, recorder.stalls, args.output)


def _report(topics: Sequence[str], counts: Sequence[TopicCount], stalls: Sequence[float], output: Path) -> int:
    repeated = sum(count.repeated for count in counts)
    recorded = sum(count.received for count in counts) - repeated
    left_out = f"; {repeated} repetitions of the sample before are left out" if repeated else ""
    print(f"recorded {recorded} messages of {len(counts)} topics to {plain(output)}{left_out}")
    for count in counts:
        if count.other_clock:
            print(
                f"{count.topic}: {count.other_clock} messages have stamps of another clock; "
                "they are dated by when they came, by the clock of the bag"
            )
    complete = not stalls
    if not any(count.received for count in counts):
        complete = False
        print(f"nothing recorded: no message came on {listed(topics)}", file=sys.stderr)
    for stall in stalls:
        print(
            f"lost: an unknown number of messages, in {stall:.1f} s in which this process did not run", file=sys.stderr
        )
    for count in counts:
        if count.lost:
            complete = False
            writers = "; ".join(f"{w.lost} of {w.received + w.lost}" for w in count.writers)
            print(f"lost: {count.lost} messages of {count.topic} (by publisher: {writers})", file=sys.stderr)
        if count.missing:
            complete = False
            print(
                f"not recorded: {count.missing} trajectories of {count.topic} that the controller has accepted: sent "
                "before the recording was ready, or lost",
                file=sys.stderr,
            )
        if count.refused:
            complete = False
            print(
                f"not recorded: {count.refused} publishers of {count.topic}, whose quality of service "
                "does not fit the first one's",
                file=sys.stderr,
            )
    return 0 if complete else 1
