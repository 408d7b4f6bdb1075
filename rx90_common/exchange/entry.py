"""The frame of a node's executable: signals, exit codes, one line instead of a traceback.

Imports next to nothing before the signals are taken care of: importing rclpy takes a second in which Ctrl-C may come.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from rx90_common.base.errors import Rx90Error
from rx90_common.process.output import with_checked_output

_HELP = """\
usage: {program} [--ros-args [-p NAME:=VALUE ...] [-r FROM:=TO ...] [--params-file FILE]]

A ROS 2 node; its parameters stand in README.md, and `ros2 param describe` tells them while it runs.
exit status: 0 after Ctrl-C or at the end of the run, 1 with one line for what is wrong, 2 wrong usage."""


def run_node(program: str, module: str, args: Sequence[str] | None) -> int:
    """Run `module.spin(args)` as the executable `program`; return its exit code.

    Ctrl-C and SIGTERM end it with 0; an error meant for the user is one line and 1.
    """
    try:
        # Taken over even where the parent ignores Ctrl-C, as rclpy does. Until the node spins nothing needs to be ended
        # in order, and an exception would get lost in a callback of the compiler.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _leave)
        from importlib import import_module

        from rx90_common.exchange.environment import prepare
        from rx90_common.kernels.announcement import announce_compilation

        words = list(sys.argv[1:] if args is None else args)
        own = words[: words.index("--ros-args")] if "--ros-args" in words else words
        if own in (["-h"], ["--help"]):
            return with_checked_output(program, lambda: print(_HELP.format(program=program)) or 0)
        if own:
            print(f"{program}: argument {own[0]!r}; accepted: --help, --ros-args ...", file=sys.stderr, flush=True)
            return 2
        prepare()
        announce_compilation(program)
        import_module(module).spin(words)
    except Rx90Error as error:
        print(f"{program}: {error}", file=sys.stderr, flush=True)
        return 1
    finally:
        # Python gives handlers of its own back to the system before it has ended; ignored signals it leaves alone.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    return 0


def _leave(_signal: int, _frame: FrameType | None) -> None:
    os._exit(0)
