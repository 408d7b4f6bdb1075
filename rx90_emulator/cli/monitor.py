"""The monitor of V+ on a serial line: the emulated arm for programs that talk to the cabinet's own prompt."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from rx90_emulator.cli.options import (
    add_node_arguments,
    add_robot_arguments,
    setup_of,
    whole_from,
)
from rx90_emulator.cli.program import cell_of_nodes

if TYPE_CHECKING:
    from rx90_emulator.cabinet.cell import Cell

_EPILOG = """\
Without --port the line is a pseudo-terminal, whose name is printed; Ctrl-C ends. docs/reference/vplus.md has the
commands. The arm moves on the wall clock.
"""


def _add_engine(parser: ArgumentParser) -> None:
    parser.epilog = _EPILOG
    parser.set_defaults(interrupted="programs and locations that were not stored are gone")
    parser.add_argument(
        "--port",
        type=whole_from(0, 65535),
        metavar="N",
        help="TCP port of 127.0.0.1; 0: any free one",
    )
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path(),
        help="where LOAD and STORE find files (the present one)",
    )
    parser.add_argument(
        "--baud", type=whole_from(300, 115200), metavar="N", help="pace of the line, 8N1 (none)"
    )
    add_robot_arguments(parser)


def _add_nodes(parser: ArgumentParser) -> None:
    _add_engine(parser)
    parser.set_defaults(ros_args=[])
    add_node_arguments(parser)


def _engine(options: Namespace) -> None:
    """Serve the monitor of an arm in the closed loop without ROS until Ctrl-C."""
    # Here, because --help must not wait for it.
    from rx90_emulator.cabinet.arm import ProgrammedArm
    from rx90_emulator.cabinet.cell import PERIOD, Cell
    from rx90_emulator.loop.stepped import SteppedLoop

    setup = setup_of(options)
    arm = ProgrammedArm(setup)
    loop = SteppedLoop(setup, arm.ready, PERIOD, keep=False)
    _serve(options, Cell(arm, loop), waits=True)


def _nodes(options: Namespace) -> None:
    """Serve the monitor of the arm of rx90_sim and rx90_controller until Ctrl-C."""
    from rx90_emulator.cabinet.cell import PERIOD

    with cell_of_nodes("rx90_monitor", options, (), PERIOD) as cell:
        _serve(options, cell, waits=False)


def _serve(options: Namespace, cell: Cell, *, waits: bool) -> None:
    from rx90_common.process.lines import PseudoTerminal, TcpLine
    from rx90_emulator.vplus.monitor import serve

    with closing(PseudoTerminal() if options.port is None else TcpLine(options.port)) as line:
        print(f"monitor of V+ on {line.name}", flush=True)
        serve(cell, options.folder, line, options.baud, waits=waits)


SUBCOMMANDS = (
    (_add_engine, _engine, "of an arm in the closed loop without ROS"),
    (_add_nodes, _nodes, "of the arm of running nodes"),
)
