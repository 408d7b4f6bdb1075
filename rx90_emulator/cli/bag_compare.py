"""Compare the joint states and temperatures of two bags and judge: exit 0 same, 1 differs, 2 cannot be compared.

Messages are paired by header.stamp and joints by name. Of several messages with one stamp, exact repetitions
count once, and different ones are paired in their order. Stamps, joints and arrays that only one bag has make a
difference. Bags of runs that began at other times are aligned with --align.
"""

from __future__ import annotations

import argparse
from decimal import Decimal, InvalidOperation
from pathlib import Path

from rx90_common.bags.tolerance import GRAMMAR, Tolerances, load_rules, parse_rule
from rx90_common.bags.topics import SERIES_FIELDS
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS

_LONGEST = 4_294_967_296  # s: stamps count so far, and two of them do not overflow 64 bits of ns
HELP = "compare two bags; exit 0 same, 1 differs, 2 cannot be compared"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("bag_a", metavar="A", help="bag: folder, .mcap, .db3 or ROS 1 .bag file")
    parser.add_argument("bag_b", metavar="B", help="bag to compare it with")
    parser.add_argument(
        "--tolerance", action="append", default=[], metavar=GRAMMAR,
        help="in rad, rad/s, Nm or °C; the most specific one that fits decides; default 0: equal bits",
    )  # fmt: skip
    parser.add_argument("--tolerances", metavar="FILE", help="YAML file of tolerances; --tolerance goes before it")
    parser.add_argument("--topics", nargs="+", metavar="TOPIC", help="compare only these")
    parser.add_argument(
        "--fields", nargs="+", choices=SERIES_FIELDS, default=list(SERIES_FIELDS), metavar="FIELD",
        help=f"compare only these of {', '.join(SERIES_FIELDS)}",
    )  # fmt: skip
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


def main(args: argparse.Namespace) -> int:
    """Compare and print; return the verdict's exit code.

    Raises:
        BagError: if the bags cannot be compared at all.
        ConfigError: if the file of tolerances is not acceptable.
    """
    # Here, because --help must not wait for them.
    from rx90_common.bags.comparison import Scope, compare_bags
    from rx90_common.bags.tables import comparison_json, comparison_text

    rules = load_rules(Path(args.tolerances)) if args.tolerances else []
    rules += [parse_rule(text) for text in args.tolerance]
    scope = Scope(
        topics=tuple(dict.fromkeys(args.topics)) if args.topics else None,
        fields=tuple(args.fields),
        start_ns=_nanoseconds("--from", args.start),
        end_ns=_nanoseconds("--to", args.end),
        common_range=args.common_range,
        align=alignment(args.align),
    )
    comparison = compare_bags(args.bag_a, args.bag_b, Tolerances(rules), scope)
    print(comparison_json(comparison) if args.json else comparison_text(comparison))
    return int(comparison.verdict)


def alignment(text: str) -> int | str:
    """Return what --align says, as `Scope` takes it.

    Raises:
        BagError: for other words, and times that no stamp has.
    """
    from rx90_common.bags.recorded import START, TRAJECTORY

    if text in (START, TRAJECTORY):
        return text
    return _time("--align", text, f"{START}, {TRAJECTORY}, or a time in s, up to {_LONGEST:,} s")


def _nanoseconds(option: str, text: str | None) -> int | None:
    return None if text is None else _time(option, text, f"a time in s, e.g. 1.25, up to {_LONGEST:,} s")


def _time(option: str, text: str, accepted: str) -> int:
    """Return a time in ns without the detour over floating point, which spoils stamps of the wall clock."""
    try:
        time = Decimal(text)
        if abs(time) <= _LONGEST:  # raises for what is no number
            return int(time * NANOSECONDS)
    except (InvalidOperation, ValueError):
        pass
    raise BagError(f"{option} is {quoted(text)}; accepted: {accepted}")
