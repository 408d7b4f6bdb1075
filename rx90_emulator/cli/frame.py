"""The frame of every executable: the one place in which errors, signals and failed output become an exit code.

Nothing slow is imported before the signals are taken care of, nor before the options are understood.
"""

from __future__ import annotations

import gc
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

from rx90_common.base.errors import DISK_ERRORS, FAILED, INTERRUPTED, REFUSED, Rx90Error, Rx90Warning
from rx90_common.base.quoting import one_line, plain
from rx90_common.base.requirements import missing_module
from rx90_common.kernels import announce_compilation
from rx90_common.process.children import end_with_parent
from rx90_common.process.files import check_output
from rx90_common.process.interrupts import (
    exit_on_signal,
    install_deferred_sigint,
    keep_exit_code,
    terminations_as_interrupts,
)
from rx90_emulator.cli.node import NODES

EXECUTABLES = {
    **dict.fromkeys(NODES, "rx90_emulator.cli.node"),
    "friction_bench": "rx90_emulator.cli.friction_rig:bench",
    "friction_ramp": "rx90_emulator.cli.friction_rig:ramp",
    "friction_rig_emulator": "rx90_emulator.cli.friction_rig:emulator",
    "rx90_bag": "rx90_emulator.cli.bag",
    "rx90_config": "rx90_emulator.cli.config",
    "rx90_correct": "rx90_emulator.cli.correct",
    "rx90_compare_measured": "rx90_emulator.cli.identify:compare_measured",
    "rx90_controller_check": "rx90_emulator.cli.controller_check",
    "rx90_demo": "rx90_emulator.cli.demo",
    "rx90_experiment": "rx90_emulator.cli.experiment",
    "rx90_export": "rx90_emulator.cli.export",
    "rx90_identify": "rx90_emulator.cli.identify",
    "rx90_line": "rx90_emulator.cli.line:line",
    "rx90_monitor": "rx90_emulator.cli.monitor",
    "rx90_own_controller": "rx90_emulator.cli.own_controller",
    "rx90_path": "rx90_emulator.cli.line:path",
    "rx90_program": "rx90_emulator.cli.program",
    "rx90_run": "rx90_emulator.cli.run",
    "rx90_sweep": "rx90_emulator.cli.sweep",
    "rx90_view": "rx90_emulator.cli.view",
}
"""The module of each executable, or MODULE:NAME. `--help` shows the module's docstring, or that of its function NAME.

- `add_arguments(parser)`, or `add_NAME`, adds the options. It may set two defaults: `interrupted` says what an
  interrupt leaves behind, with {names} of options in it; `ros_args=[]` accepts arguments for ROS, which `main` gets
  with their `--ros-args`.
- `main(options)`, or NAME, returns the exit code or None, and raises Rx90Error; what is slow to import it imports
  itself. `options.executables` is this table. A command of verbs (`add_verbs`) has no `main`.
"""

_OBJECTS = 20_000
"""New objects between two searches for garbage: imports make 100,000 that stay, and Python would search each 700."""


def __getattr__(name: str) -> Callable[[], int]:
    """Return the entry point of an executable, which the console script of its name imports from here."""
    if name not in EXECUTABLES:
        raise AttributeError(name)
    return partial(execute, name)


def main() -> int:
    """Run `python -m rx90_emulator EXECUTABLE ...`."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in EXECUTABLES:
        print(f"usage: python -m rx90_emulator {{{','.join(EXECUTABLES)}}} ...", file=sys.stderr)
        return REFUSED
    end_with_parent()
    return execute(name, sys.argv[2:])


def execute(program: str, words: Sequence[str] | None = None) -> int:
    """Run an executable as this process's only task, by default with the process's arguments; return its exit code."""
    words = sys.argv[1:] if words is None else words
    if program in NODES and not (words and words[0].isalpha()):  # a node's verb is a command
        exit_on_signal()
    else:
        install_deferred_sigint()
        gc.set_threshold(_OBJECTS)
    keep_exit_code()
    announce_compilation(program)
    check_output()
    # NumPy reads it when it is imported. Matrices are small here: more threads would wait for each other in a loop, and
    # take the processor from whatever else runs.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return run(program, words)


def run(program: str, words: Sequence[str]) -> int:
    """Run an executable with these arguments; return its exit code. Every error is one line on standard error."""
    options = SimpleNamespace(executables=EXECUTABLES)
    try:
        try:
            return _run(program, words, options)
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except SystemExit as end:  # --help, wrong usage, a reader of the output that has gone
        return int(end.code or 0)
    except Rx90Error as error:
        _say(f"{program}: {error}")
        return error.exit_code
    except OSError as error:  # of a file's name: one too long, or below a folder that may not be read
        if error.filename is None:
            raise
        _say(f"{program}: {plain(error.filename)}: {error.strerror}")
        return FAILED if error.errno in DISK_ERRORS else REFUSED
    except ImportError as error:
        line = missing_module(error)
        if line is None:
            raise
        _say(f"{program}: {line}")
        return FAILED
    except KeyboardInterrupt:
        note = getattr(options, "interrupted", "").format(**vars(options))
        if sys.stderr.isatty():  # ^C stands in the line
            print(file=sys.stderr)
        _say(f"{program}: interrupted{'; ' * bool(note)}{note}")
        return INTERRUPTED


def _run(program: str, words: Sequence[str], options: SimpleNamespace) -> int:
    from rx90_emulator.cli.options import command_of, split_ros_args

    parser, main = command_of(program, EXECUTABLES[program])
    own, ros_args = split_ros_args(words)
    parser.parse_args(own, options)
    if ros_args:
        if not hasattr(options, "ros_args"):
            parser.error(f"unrecognized arguments: {' '.join(ros_args)}")
        options.ros_args = ros_args
    # Only now: a recorder that has a handler for SIGTERM leaves a whole bag.
    with terminations_as_interrupts(), warnings.catch_warnings():
        warnings.simplefilter("always", Rx90Warning)
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, Rx90Warning):
                _say(f"{program}: warning: {message}")
            else:
                others(message, category, *where, **more)

        warnings.showwarning = cast(Any, show)
        return int(main(options) or 0)


def _say(line: str) -> None:
    print(one_line(line), file=sys.stderr, flush=True)
