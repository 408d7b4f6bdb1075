"""Show friction elements beside each other, each number with its source, and put elements of one file into another.

FRICTION is a shipped robot (rx90b), published friction (puma560), a friction file or a robot folder, and
FRICTION:ELEMENT one element of it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.errors import DONE, ConfigError, check_replaced
from rx90_common.base.quoting import plain
from rx90_common.process.files import write_text
from rx90_emulator.cli.options import POSITIVE, new_file, place

HELP = "show friction elements beside each other, and put elements of one file into another"
_HEAD = "# Elements of several files; each says below `note` where it was taken from.\n"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("friction", nargs="+", metavar="FRICTION", help="a name or a file, or an element of it")
    parser.add_argument("--speed", type=POSITIVE, default=1.0, metavar="RAD/S",
                        help="highest velocity of table and plot (%(default)s)")  # fmt: skip
    parser.add_argument("--plot", type=place, metavar="FILE", help="draw the torque over velocity: .png, .svg or .pdf")
    parser.add_argument("--force", action="store_true", help="replace a plot that exists")
    parser.add_argument("--take", action="append", default=[], metavar="[ELEMENT=]FRICTION[:ELEMENT]",
                        help="put an element into the first FRICTION, or all of equal names; needs -o")  # fmt: skip
    parser.add_argument("-o", "--output", type=new_file, metavar="FILE", help="where to write what --take makes")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def main(options: argparse.Namespace) -> int:
    """Print the table, and write what is asked for.

    Raises:
        Rx90Error: if it cannot be done.
    """
    # Here, because --help must not wait for them.
    from rx90_common.report.picture import PICTURES, write_picture
    from rx90_emulator.configuration.friction_comparison import comparison_json, comparison_plot, comparison_table
    from rx90_emulator.configuration.friction_sets import FrictionChoice, with_taken

    if bool(options.take) != (options.output is not None):
        raise ConfigError("--take and --output: only one of them is there; accepted: both, or none")
    plot: Path | None = options.plot
    if plot is not None and plot.suffix.lower() not in PICTURES:
        raise ConfigError(f"--plot {plain(plot)}; accepted: a file with {', '.join(PICTURES)}")
    if plot is not None:
        check_replaced(plot, force=options.force)
    choices = [FrictionChoice.named(text) for text in options.friction]
    if options.output is not None:
        write_text(options.output, with_taken(choices[0], options.take).text(_HEAD))
        choices.insert(1, FrictionChoice.named(str(options.output)))
    told = comparison_json if options.json else comparison_table
    print(told(choices, options.speed))
    if plot is not None:
        write_picture(comparison_plot(choices, options.speed), plot, "Friction torque at constant velocity")
        if not options.json:
            print(f"plot: {plain(plot.resolve())}")
    return DONE
