"""Entry point of `rx90_bag`: record, compare and summarise bags."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

from rx90_common.base.errors import Rx90Error

_VERBS = ("record", "compare", "info")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb and return its exit code, the error's with one line when it cannot be done."""
    own, ros_args = _split(list(sys.argv[1:] if argv is None else argv))
    parser = argparse.ArgumentParser(prog="rx90_bag", description="Record, compare and summarise bags.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    # Only what is asked for is loaded: a recorder must answer signals soon after its start.
    names = own[:1] if own[:1] and own[0] in _VERBS else _VERBS
    modules = {name: importlib.import_module(f"rx90_emulator.cli.bag_{name}") for name in names}
    for name, module in modules.items():
        module.add_arguments(verbs.add_parser(name, help=module.HELP, description=module.__doc__))
    args = parser.parse_args(own)
    try:
        return int(modules[args.verb].main(args, ros_args))
    except Rx90Error as error:
        print(f"rx90_bag {args.verb}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 130


def _split(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Separate what follows --ros-args, which `ros2 run` and launch files append."""
    if "--ros-args" not in arguments:
        return arguments, []
    at = arguments.index("--ros-args")
    return arguments[:at], arguments[at + 1 :]


if __name__ == "__main__":
    sys.exit(main())
