"""Do the trajectories of a recorded bag again in the closed loop without ROS, from where the arm began."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from functools import partial
from pathlib import Path

from rx90_common.base.quoting import one_line
from rx90_emulator.cli.run import (
    add_initial_position,
    add_run_arguments,
    check_count,
    finish,
    setup_of,
)


def add_arguments(parser: ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "bag", type=Path, metavar="BAG", help="bag: folder, .mcap, .db3 or ROS 1 .bag file"
    )
    add_initial_position(parser, "the first joint_states")
    add_run_arguments(parser)


def main(options: Namespace) -> None:
    """Read the bag, run, show what came out, write what was asked for."""
    # Here, because --help must not wait for it.
    from rx90_emulator.loop.recorded_run import read_run, replay

    setup = setup_of(options)
    check_count(options.initial_position, setup)
    recorded = read_run(options.bag, setup, options.initial_position)
    starts = ", ".join(
        f"{command.start * setup.rates.position_period:.3f} s" for command in recorded.commands
    )
    print(f"trajectories in {one_line(options.bag)}: {len(recorded.commands)}, from {starts}")
    if options.seed is None:
        print(
            "seed 0: the bag tells none"
            if recorded.seed is None
            else f"seed {recorded.seed}, as the bag tells"
        )
    else:
        if recorded.seed not in (None, options.seed):
            _warn(f"the seed of that run was {recorded.seed}; here --seed {options.seed} holds")
        recorded = replace(recorded, seed=options.seed)
    others = sorted({*recorded.changed, *recorded.given})
    if others:
        _warn(
            f"{', '.join(others)} had other values in that run; here the controller file and the options of this "
            "command hold"
        )
    finish(partial(replay, setup, recorded), recorded.initial_position, options)


def _warn(text: str) -> None:
    print(f"rx90 replay: warning: {text}", file=sys.stderr)
