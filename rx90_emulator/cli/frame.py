"""The frame of every executable: the one place in which errors, signals and failed output become an exit code.

Nothing slow is imported before the signals are taken care of, nor before the options are understood.
"""

from __future__ import annotations

import gc
import os
import sys
import warnings
from collections.abc import Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

from rx90_common.base.errors import (
    DISK_ERRORS,
    DONE,
    FAILED,
    INTERRUPTED,
    REFUSED,
    ConfigError,
    Rx90Error,
    Rx90Warning,
)
from rx90_common.base.quoting import one_line, plain, quoted
from rx90_common.kernels import announce_compilation
from rx90_common.process.children import end_with_parent
from rx90_common.process.files import check_output
from rx90_common.process.interrupts import (
    exit_on_signal,
    install_deferred_sigint,
    keep_exit_code,
    terminations_as_interrupts,
)
from rx90_common.process.requirements import missing_module
from rx90_emulator.cli.node import NODES

VERBS = (
    "experiment",
    "identify",
    "rig",
    "export",
    "run",
    "replay",
    "line",
    "path",
    "program",
    "monitor",
    "correct",
    "demo",
    "view",
    "bag",
    "sweep",
    "check",
    "config",
    "completion",
)
"""The verbs of `rx90`. Each is a module of this folder, of its name; `--help` shows the module's docstring.

- `add_arguments(parser)` adds the options. It may set two defaults: `interrupted` says what an interrupt leaves behind,
  with {names} of options in it; `ros_args=[]` accepts arguments for ROS, which `main` gets with their `--ros-args`.
- `main(options)` returns the exit code or None, and raises Rx90Error; what is slow to import it imports itself. A verb
  that has verbs of its own (`add_verbs`) has no `main`.
"""

EXECUTABLES = ("rx90", *NODES)

COMMANDS = (*NODES, *(f"rx90 {verb}" for verb in VERBS))

_PAGE = """\
usage: rx90 VERB [OPTIONS]                     rx90 VERB --help says more of each

to study friction
  experiment           plan and run the motions that friction is identified from
  identify             friction or the whole dynamics from bags and tables, with report and verdict
  rig                  torque ramps on a friction rig, real or emulated
  export               arm and friction for MuJoCo, Gazebo or Isaac Lab

to program the robot
  run, replay          a line, path or trajectory, or those of a bag, without ROS, with the path error
  line, path           the same motions, sent to the controller node
  program, monitor     programs of V+, and the prompt of V+ on a serial line
  correct              learn a correction of a path from trial to trial

to write controllers and nodes
  demo, view           the whole system once, with a report; the arm in the browser
  bag                  record, compare, draw, summarise, export and import bags
  check                test a controller of your own
  config, sweep        check parameter files and show their values; many runs over parameters

nodes: ros2 run rx90_emulator rx90_cell (the arm and its controller), rx90_sim, rx90_controller, friction_bench
shell: eval "$(rx90 completion bash)"; zsh and fish, too
"""

_OBJECTS = 20_000
"""New objects between two searches for garbage: imports make 100,000 that stay, and Python would search each 700."""


def main() -> int:
    """Run `python -m rx90_emulator EXECUTABLE ...`, or `python -m rx90_emulator VERB ...`."""
    words = sys.argv[1:]
    named = words and words[0] in (*NODES, "rx90")
    program = words.pop(0) if named else "rx90"
    end_with_parent()
    return execute(program, words)


def execute(program: str, words: Sequence[str] | None = None) -> int:
    """Run an executable as this process's only task, by default with the process's arguments; return its exit code."""
    words = sys.argv[1:] if words is None else words
    if program in NODES:
        exit_on_signal()
    else:
        install_deferred_sigint()
        gc.set_threshold(_OBJECTS)
    keep_exit_code()
    command, words = _split([*program.split(), *words])
    announce_compilation(command)
    check_output()
    # NumPy reads it when it is imported. Matrices are small here: more threads would wait for each other in a loop, and
    # take the processor from whatever else runs.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return run(command, words)


rx90 = partial(execute, "rx90")
rx90_sim = partial(execute, "rx90_sim")
rx90_controller = partial(execute, "rx90_controller")
rx90_cell = partial(execute, "rx90_cell")
friction_bench = partial(execute, "friction_bench")


def run(command: str, words: Sequence[str]) -> int:
    """Run a command with these arguments; return its exit code. Every error is one line on standard error.

    Args:
        command: an executable; of `rx90` with its verb and those below it, such as `rx90 bag compare`.
        words: what follows.
    """
    program, words = _split([*command.split(), *words])
    options = SimpleNamespace()
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
    except (
        OSError
    ) as error:  # of a file's name: one too long, or below a folder that may not be read
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
        interrupted = f"{program}: interrupted"
        _say(f"{interrupted}; {note}" if note else interrupted)
        return INTERRUPTED


def _split(words: Sequence[str]) -> tuple[str, list[str]]:
    """Return the name of a command, an executable or `rx90` with its verb, and its arguments."""
    length = 2 if words[0] == "rx90" and len(words) > 1 and words[1] in VERBS else 1
    return " ".join(words[:length]), list(words[length:])


def _run(program: str, words: Sequence[str], options: SimpleNamespace) -> int:
    if program == "rx90":
        if words and words[0] not in ("-h", "--help"):
            raise ConfigError(f"{quoted(words[0])} is no verb; accepted: {', '.join(VERBS)}")
        print(_PAGE, end="")
        return DONE
    from rx90_emulator.cli.options import command_of, split_ros_args

    parser, main = command_of(program)
    own, ros_args = split_ros_args(words)
    parser.parse_args(own, options)
    if ros_args:
        if not hasattr(options, "ros_args"):
            parser.error(f"unrecognized arguments: {' '.join(ros_args)}")
        options.ros_args = ros_args
    # Only now: a recorder that has a handler for SIGTERM leaves a whole bag.
    with terminations_as_interrupts(), warnings.catch_warnings():
        warnings.simplefilter("always", Rx90Warning)

        def show(message: Warning | str, *_: Any, **__: Any) -> None:
            _say(f"{program}: warning: {message}")

        warnings.showwarning = show
        return int(main(options) or 0)


def _say(line: str) -> None:
    print(one_line(line), file=sys.stderr, flush=True)
