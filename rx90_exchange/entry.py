"""The frame of a node's executable: signals, exit codes, one line instead of a traceback.

Imports nothing slow, so that Ctrl-C is handled from the first moment on.
"""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from rx90_common.errors import Rx90Error
from rx90_exchange.environment import prepare


def run_node(program: str, module: str, args: Sequence[str] | None) -> int:
    """Run `module.spin(args)` as the executable `program`; return its exit code.

    Ctrl-C and SIGTERM end it with 0; an error meant for the user is one line and 1.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        prepare()
        importlib.import_module(module).spin(list(sys.argv[1:] if args is None else args))
    except Rx90Error as error:
        print(f"{program}: {error}", file=sys.stderr, flush=True)
        return 1
    except KeyboardInterrupt:
        pass
    return 0


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
