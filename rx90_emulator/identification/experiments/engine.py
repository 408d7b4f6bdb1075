"""Run experiments through the closed loop without ROS, into bags as the recorder writes them."""

from __future__ import annotations

from pathlib import Path

from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_emulator.identification.experiments.folder import TOPICS
from rx90_emulator.identification.experiments.plan import Experiment
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

_SETTLING = 0.2  # s, after the end


def run_on_engine(setup: Setup, experiment: Experiment, bag: Path, storage: str = "mcap") -> None:
    """Simulate one experiment and write its bag.

    Raises:
        BagError: if the bag exists or cannot be written.
        DivergenceError: naming joint and tick.
    """
    result = simulate(
        setup,
        experiment.points,
        duration=experiment.duration + _SETTLING,
        record_fast="motor_states" in TOPICS[experiment.kind],
    )
    wanted = [absolute(topic) for topic in TOPICS[experiment.kind]]
    series = [one for one in result.series.values() if one.topic in wanted]
    description = string_message("/robot_description", setup.robot.urdf)
    write_joint_states(bag, series, storage=storage, messages=[description])
