"""Run a program of V+ on the emulated arm: its motions with their path error, signals, text, and the bag."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import aligned, one_line, plain, quoted
from rx90_emulator.cli.options import (
    POSITIVE,
    add_node_arguments,
    add_output,
    add_robot_arguments,
    add_slow_only,
    check_picture,
    new_file,
    new_folder,
    number,
    setup_of,
    whole_number,
)

if TYPE_CHECKING:
    from rx90_emulator.cabinet.cell import Cell, Change
    from rx90_emulator.cabinet.record import ProgramRun
    from rx90_emulator.vplus.run import Options
    from rx90_emulator.vplus.tree import Memory, Readings

_EPILOG = """\
FILE is a file of V+ (.v2, .pg, with data sections or .lc beside it), or a folder of them. The arm begins at READY.
Inputs change at the times of --inputs: a YAML such as {1001: 1.0, 1002: [2.0, 3.5]}, on and off in turns, s.
docs/reference/vplus.md says what of the language is there, and which readings are assumed.
"""
_PERCENT = number("a percentage above 0, up to 100", lambda value: 0.0 < value <= 100.0)
_MOST_FAULTS = 20
_PERIODS = (1, 2, 4, 8, 16)


def _add_engine(parser: ArgumentParser) -> None:
    _add_program(parser)
    parser.set_defaults(interrupted="only what is named above was written")
    add_output(parser, new_folder, "bag folder to write; must not exist", metavar="FOLDER")
    add_slow_only(parser)
    parser.add_argument(
        "--report", type=new_file, metavar="FILE", help="page to write (.html); must not exist"
    )
    parser.add_argument(
        "--plot", type=new_file, metavar="FILE", help="picture of the tool's path to write"
    )


def _add_nodes(parser: ArgumentParser) -> None:
    _add_program(parser)
    parser.set_defaults(ros_args=[], output=None, report=None, plot=None)
    add_node_arguments(parser)


def _add_file(parser: ArgumentParser) -> None:
    parser.epilog = _EPILOG
    parser.formatter_class = RawDescriptionHelpFormatter
    parser.add_argument("file", metavar="FILE", type=Path, help="file or folder of programs")
    parser.add_argument(
        "--reading",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="another reading of an uncertain part",
    )


def _add_program(parser: ArgumentParser) -> None:
    _add_file(parser)
    parser.add_argument(
        "name", metavar="NAME", nargs="?", default="", help="program (the first one)"
    )
    parser.add_argument(
        "arguments",
        metavar="ARG",
        nargs="*",
        help="its arguments: numbers, other words are strings",
    )
    parser.add_argument(
        "--inputs", type=Path, metavar="FILE", help="YAML of times at which inputs change"
    )
    parser.add_argument(
        "--monitor-speed", type=_PERCENT, default=100.0, metavar="PERCENT", help="(%(default)g)"
    )
    parser.add_argument(
        "--planning",
        type=whole_number,
        choices=_PERIODS,
        default=16,
        help="ms from one planned set-point to the next (16)",
    )
    parser.add_argument(
        "--idle",
        type=POSITIVE,
        default=60.0,
        metavar="S",
        help="longest time without a motion, s (60)",
    )
    parser.add_argument(
        "--longest", type=POSITIVE, default=300.0, metavar="S", help="longest run, s (300)"
    )
    add_robot_arguments(parser)


def _engine(options: Namespace) -> None:
    """Run a program in the closed loop without ROS, show what it did, write what was asked for."""
    if options.plot is not None:
        check_picture(options.plot)
    # Here, because --help must not wait for it.
    from rx90_emulator.vplus.run import run_program

    inputs, memory = _prepared(options)
    run = run_program(
        setup_of(options),
        memory,
        options.name,
        arguments=options.arguments,
        inputs=inputs,
        options=_chosen(options),
        show=_show,
    )
    _end(run, options)


def _nodes(options: Namespace) -> None:
    """Run a program on rx90_sim and rx90_controller, from where the arm is; rx90 bag record records it."""
    from rx90_emulator.vplus.run import run_in

    inputs, memory = _prepared(options)
    chosen = _chosen(options)
    with cell_of_nodes("rx90_program", options, inputs, chosen.period) as cell:
        cell.show = _show
        run = run_in(cell, memory, options.name, options.arguments, chosen)
    _end(run, options)


@contextmanager
def cell_of_nodes(
    name: str, options: Namespace, inputs: Sequence[Change], period: float
) -> Iterator[Cell]:
    """Give the cell of the arm of running nodes to a client with a name; `period` of its beats, s."""
    setup = setup_of(options)
    from rx90_common.exchange.ros_start import prepare

    prepare()
    from rx90_common.exchange.client_node import client_node
    from rx90_controller.node.program_client import ProgramClient
    from rx90_emulator.cabinet.arm import ProgrammedArm
    from rx90_emulator.cabinet.cell import Cell

    with client_node(name, options.timeout, print, options.ros_args) as client:
        nodes = ProgramClient(client, options.node, setup.robot.joint_names)
        cell = Cell(ProgrammedArm(setup), nodes, inputs, period)
        cell.publish = nodes.signals(cell.receive)
        yield cell


def _prepared(options: Namespace) -> tuple[list[Change], Memory]:
    """Return the changes of inputs, and the programs."""
    from rx90_emulator.cabinet.cell import load_inputs

    inputs = [] if options.inputs is None else load_inputs(options.inputs)
    return inputs, _load(options)


def _check(options: Namespace) -> None:
    """Read and check files of programs; nothing runs."""
    memory = _load(options)
    print(f"{len(memory.programs)} programs without faults: {', '.join(memory.programs)}")


def _load(options: Namespace) -> Memory:
    """Return the programs of a file or folder; of several faults, those behind the first are shown before it."""
    from rx90_emulator.vplus.program import load_programs
    from rx90_emulator.vplus.values import LoadError

    try:
        return load_programs(options.file, _readings(options.reading))
    except LoadError as error:
        for fault in error.faults[1:_MOST_FAULTS]:
            print(one_line(fault))
        raise


def _chosen(options: Namespace) -> Options:
    from rx90_emulator.vplus.run import Options

    return Options(
        monitor_speed=options.monitor_speed,
        period=options.planning * 1e-3,
        idle=options.idle,
        longest=options.longest,
        record_fast=options.output is not None and not options.slow_only,
    )


def _end(run: ProgramRun, options: Namespace) -> None:
    """Show what a run did, write what was asked for, and raise the error that ended it, if one did."""
    from rx90_common.process.files import write_text
    from rx90_emulator.cabinet.record import draw, page, table
    from rx90_emulator.loop.result import write_bag

    for change in run.cell.changes:
        print(f"{change.time:9.3f} s  signal {change.signal} {'on' if change.on else 'off'}")
    if run.motions:
        print("\n".join(aligned(table(run), right=range(2, 9))))
    print(f"{len(run.motions)} motions, cycle time {run.cell.time:.3f} s")
    if options.output is not None and run.result is not None:
        write_bag(run.result, options.output)
        print(one_line(f"bag: {options.output}"))
    if options.report is not None:
        write_text(options.report, page(run, plain(options.file)))
        print(one_line(f"report: {options.report}"))
    if options.plot is not None:
        draw(run, options.plot)
        print(one_line(f"picture: {options.plot}"))
    if run.error is not None:
        raise run.error


def _show(text: str, time: float, ends: bool) -> None:
    print(f"{time:9.3f} s  {text}" if ends else text, flush=True)


def _readings(words: list[str]) -> Readings:
    """Return the readings, with those that were given."""
    from rx90_emulator.vplus.tree import Readings

    given = {}
    for word in words:
        name, _, value = word.partition("=")
        if name not in Readings.model_fields:
            raise ConfigError(
                f"--reading {quoted(word)}; accepted: NAME=VALUE, of {', '.join(Readings.model_fields)}"
            )
        try:
            given[name] = json.loads(value)
        except ValueError:
            raise ConfigError(
                f"--reading {quoted(word)}; accepted: true, false or a number behind the ="
            ) from None
    return Readings().replaced(**given)


SUBCOMMANDS = (
    (_add_engine, _engine, "run a program in the closed loop without ROS"),
    (_add_nodes, _nodes, "run a program on the running nodes"),
    (_add_file, _check, "read and check files, run nothing"),
)
