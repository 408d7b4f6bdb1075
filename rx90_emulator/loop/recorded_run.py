"""A run found in a bag, so that the closed loop without ROS can do it again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.recorded import read_trajectories
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError, check_type, located
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.topics import SEED
from rx90_controller.law.parameters import CS7BParameters
from rx90_controller.trajectory.points import points_from_message
from rx90_controller.trajectory.request import GoalOptions
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.recorded_setup import check_robot, read_changes, read_values
from rx90_emulator.loop.result import MotionCommand, RunResult
from rx90_emulator.loop.setup import Setup

OF_LAW = ("servo.", "feed_forward.", "supervision.")
"""How the names of parameters begin that are constants of the law: the sections of the controller file."""
_AT_REST = 0.01  # rad/s
_LATEST_BEGIN = 100.0  # s of simulated time before the bag begins; the loop runs through it


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """What was run.

    Attributes:
        commands: the trajectories, in the order of their start.
        initial_position: where the arm rested, rad, shape (n,).
        duration: simulated time at the end of the bag, s.
        changed: names of the law's parameters that were changed meanwhile; `replay` has those of the setup throughout.
        given: names of those that had other values than the setup's from the beginning, by the bag, and of options of
            the controller by which it accepted more trajectories than `replay` does.
        seed: of all that was random in the arm, None if the bag tells none: then `replay` has that of the setup.
    """

    commands: tuple[MotionCommand, ...]
    initial_position: Array
    duration: float
    changed: tuple[str, ...] = ()
    given: tuple[str, ...] = ()
    seed: int | None = None


def read_run(bag: Path | str, setup: Setup, initial_position: Array | None = None) -> RecordedRun:
    """Read the trajectories that a recorded controller followed, and where the arm began.

    A bag that begins after time 0 is taken to begin with an arm that has rested there since time 0. A trajectory that
    another one replaced before it began is among the trajectories.

    Args:
        bag: recorded by `rx90 bag record`, or written by `write_bag`.
        setup: the robot, for its name, the names of its joints and its rates.
        initial_position: rad, shape (n,), instead of the first one of `joint_states`.

    Raises:
        TrajectoryError: if a trajectory is none for this robot.
    """
    check_type(setup=(setup, Setup))
    check_robot(bag, setup.robot.model.name)
    states = read_joint_states(bag, "joint_states", setup.robot.joint_names)
    first = int(states.stamp_ns.min())
    last = int(states.stamp_ns.max())
    if first > _LATEST_BEGIN * NANOSECONDS:
        raise BagError(
            f"{plain(bag)}: begins at {first / NANOSECONDS:.3f} s; accepted: a bag that begins within "
            f"{_LATEST_BEGIN:g} s of simulated time"
        )
    if initial_position is None:
        initial_position = setup.plant().position_of(
            _position_at_rest(bag, states, setup.robot.joint_names)
        )
    values = read_values(bag)
    if values.get(SEED) is not None and type(values[SEED]) is not int:
        raise BagError(
            f"{plain(bag)}: its {SEED} is {quoted(values[SEED])}; accepted: a whole number"
        )
    commands = []
    for one in read_trajectories(bag):
        with located(plain(bag)):
            points = (
                points_from_message(setup.robot.joint_names, one.message)
                if one.message.points
                else None
            )
        commands.append(MotionCommand(setup.rates.start_tick(one.start_ns / NANOSECONDS), points))
    return RecordedRun(
        commands=tuple(commands),
        initial_position=initial_position,
        duration=last / NANOSECONDS + setup.rates.position_period,
        changed=tuple(sorted({name for name in read_changes(bag) if name.startswith(OF_LAW)})),
        given=tuple(
            sorted(
                name for name, value in values.items() if _is_other(name, value, setup.controller)
            )
        ),
        seed=values.get(SEED),
    )


def replay(setup: Setup, run: RecordedRun, *, record_fast: bool = False) -> RunResult:
    """Do a recorded run again through the closed loop without ROS, with its seed.

    Raises:
        TrajectoryError: if a trajectory is refused.
        DivergenceError: naming joint and tick.
        SupervisionError: naming joint, value, limit and time, if the controller's supervision cuts the power.
    """
    check_type(setup=(setup, Setup), run=(run, RecordedRun))
    if run.seed is not None:
        setup = replace(setup, seed=run.seed)
    return simulate_commands(
        setup, run.commands, run.initial_position, run.duration, record_fast=record_fast
    )


def _is_other(name: str, value: Any, law: CS7BParameters) -> bool:
    """Return whether a parameter of the controller node had another value than the setup's law, or than its default."""
    if not name.startswith(OF_LAW):
        return value is True and name in GoalOptions.model_fields
    block, _, key = name.partition(".")
    return not np.array_equal(value, getattr(getattr(law, block), key))


def _position_at_rest(bag: Path | str, states: JointSeries, names: Sequence[str]) -> Array:
    if states.position is None:
        raise BagError(f"{plain(bag)}: joint_states without positions; accepted: a bag with them")
    row = int(np.argmin(states.stamp_ns))
    velocity = np.zeros(1) if states.velocity is None else states.velocity[row]
    joint = int(np.argmax(np.abs(velocity)))
    if not abs(velocity[joint]) <= _AT_REST:
        raise BagError(
            f"{plain(bag)}: {names[joint]} begins with {velocity[joint]:.4g} rad/s; accepted: up to {_AT_REST:g} "
            "rad/s, or an initial position of your own"
        )
    return np.array(states.position[row])
