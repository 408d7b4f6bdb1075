"""Move the tool along a path of lines, arcs and splines, from a path file."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter

from rx90_emulator.cli.line import add_sending, plan_and_send

_EPILOG = """\
The path file says where its points come from: itself, a CSV file or a DXF drawing.
example: rx90 path seam.yaml --approach
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog = _EPILOG
    parser.formatter_class = RawDescriptionHelpFormatter
    parser.add_argument(
        "path",
        metavar="PATH",
        help="path file, or the name of a shipped one, such as paths/circle.yaml",
    )
    add_sending(parser)


def main(options: Namespace) -> None:
    """Plan the path, and send it."""
    from rx90_emulator.loop.path_file import load_path

    plan_and_send(options, lambda *_: load_path(options.path))
