"""Agreements between both nodes: names of topics and motors, time mode, rates and robot."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import NamedTuple

from rx90_common.base.errors import ConfigError, ExchangeError, MessageError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import Rates

MOTOR_STATES = "motor_states"
MOTOR_COMMANDS = "motor_commands"
JOINT_COMMANDS = "joint_commands"
"""Efforts at the joints, in place of MOTOR_COMMANDS."""
MEASURED_JOINT_STATES = "measured_joint_states"
"""Measurements of the drives, converted to the joints: the states that JOINT_COMMANDS answer."""
MOTOR_INTERFACE = "motor"
JOINT_INTERFACE = "joint"
COMMAND_INTERFACES = {
    MOTOR_INTERFACE: (MOTOR_STATES, MOTOR_COMMANDS),
    JOINT_INTERFACE: (MEASURED_JOINT_STATES, JOINT_COMMANDS),
}
"""The sides on which the simulation can be commanded, each with the topics of states and of commands."""
REFERENCE = "reference"
"""Private topic of the controller: its set-points."""
TRAJECTORY_ACCEPTED = "trajectory_accepted"
"""Private topic of the controller: the trajectory that it follows, stamped with its start time."""
COMMANDED_TRAJECTORY = "joint_trajectory"
"""Private topic of the controller: the trajectory that it is to follow."""
OF_ACTION = "follow_joint_trajectory"
"""Frame of the messages on TRAJECTORY_ACCEPTED that came as goals, and not on COMMANDED_TRAJECTORY."""
CORRECTION = "correction"
"""Private topic of the controller: offsets of the position set-points, while a correction is played."""
COMMANDED_CORRECTION = "commanded_correction"
"""Private topic of the controller: offsets for the trajectory with the identity in their frame, sent before it."""
CORRECTED = "corrected"
"""Frame of a trajectory that is refused where its correction has not come before it."""
PARAMETERS = "parameters"
"""Private topic of both nodes: parameters that may be changed while they run, stamped with the time of each change."""
SEED = "seed"
"""Parameter of the simulation, which its topic PARAMETERS publishes: of all that is random in the arm."""
REFERENCE_ACCELERATION = "reference_acceleration"
COMMANDED_CURRENT = "commanded_current"
MOTOR_CURRENT = "motor_current"
DETAILS = (REFERENCE_ACCELERATION, COMMANDED_CURRENT, MOTOR_CURRENT)
"""Private topics of the controller: signals of the paper's block diagram that are not on the other topics."""
DETAIL_DECIMATION = 10
"""Ticks of the position loop for each message of these."""
SAMPLED = "sampled"
"""Namespace of the topics on which the simulation publishes its states for viewers."""
SAMPLED_RATE = 100
"""Of these, Hz of simulated time."""
MAX_DISPLAY_RTF = 1.2
"""Simulated s in one of the wall clock above which viewers are shown fewer samples."""
TIME_MODE = "time_mode"
"""Latched by the simulation: the time mode; the controller follows it."""
LOCK_STEP = "lock_step"
FREE_RUNNING = "free_running"
TIME_MODES = (LOCK_STEP, FREE_RUNNING)
_TIME_MODE = re.compile(
    rf"({LOCK_STEP}|{FREE_RUNNING}) base_rate=(\d+) position_rate=(\d+)(?: robot=(.*))?", re.DOTALL
)


def motor_names(motors: int) -> tuple[str, ...]:
    """Return the names of so many motors, from base to tip."""
    return tuple(f"motor_{i}" for i in range(1, motors + 1))


class TimeMode(NamedTuple):
    """The content of TIME_MODE, latched by the simulation: time mode, and the rates and the robot of both nodes.

    Attributes:
        mode: one of TIME_MODES.
        rates: of the simulation.
        robot: name of its robot; None if the text has none.
    """

    mode: str
    rates: Rates
    robot: str | None = None

    @property
    def text(self) -> str:
        """Return the text of the message."""
        text = f"{self.mode} base_rate={self.rates.base_hz} position_rate={self.rates.position_hz}"
        return text if self.robot is None else f"{text} robot={self.robot}"

    @classmethod
    def parse(cls, text: str) -> TimeMode:
        """Read the text of a message.

        Raises:
            MessageError: if it is none.
        """
        form = _TIME_MODE.fullmatch(text)
        if form is not None:
            mode, base, position, robot = form.groups()
            with suppress(ValueError, ConfigError):
                return cls(mode, Rates(int(base), int(position)), robot)
        accepted = (
            f"{', '.join(TIME_MODES)} with rates, as in lock_step base_rate=4000 position_rate=1000"
        )
        raise MessageError(f"{TIME_MODE} says {quoted(text)}; accepted: {accepted}")

    def check(self, rates: Rates, robot: str) -> None:
        """Compare the simulation's rates and robot with the controller's.

        Raises:
            ExchangeError: naming the first difference, with both values.
        """
        for name in ("base", "position"):
            theirs = getattr(self.rates, f"{name}_hz")
            ours = getattr(rates, f"{name}_hz")
            if theirs != ours:
                raise ExchangeError(
                    f"{name}_rate is {ours} Hz here and {theirs} Hz in the simulation; accepted: the same in both nodes"
                )
        if self.robot not in (None, robot):
            raise ExchangeError(
                f"the robot is {quoted(robot)} here and {quoted(self.robot)} in the simulation; accepted: the same in "
                "both nodes, by their parameters robot or urdf"
            )
