"""What both nodes must agree on: the names of topics, motors and time modes."""

from __future__ import annotations

from typing import Final

MOTOR_NAMES: Final = tuple(f"motor_{i}" for i in range(1, 7))
MOTOR_STATES: Final = "motor_states"
MOTOR_COMMANDS: Final = "motor_commands"
TRAJECTORY_ACCEPTED: Final = "trajectory_accepted"
"""Private topic of the controller: what it follows, stamped with the time at which that starts."""
COMMANDED_TRAJECTORY: Final = "joint_trajectory"
"""Private topic of the controller: what it is to follow."""
OF_ACTION: Final = "follow_joint_trajectory"
"""Frame of the messages on TRAJECTORY_ACCEPTED that came as goals, and not on COMMANDED_TRAJECTORY."""
PARAMETERS: Final = "parameters"
"""Private topic of both nodes: parameters that may be changed while they run, stamped with the time of each change."""
TEMPERATURES: Final = "temperatures"
"""Of the simulation: how warm the joints are, and the windings of the motors."""
SEED: Final = "seed"
"""Parameter of the simulation, which its topic PARAMETERS tells: of all that is random in the arm."""
TEMPERATURE_RATE: Final = "temperature_rate"
"""Parameter of the simulation, which its topic PARAMETERS tells: of TEMPERATURES, Hz."""
REFERENCE_ACCELERATION: Final = "reference_acceleration"
COMMANDED_CURRENT: Final = "commanded_current"
MOTOR_CURRENT: Final = "motor_current"
DETAILS: Final = (REFERENCE_ACCELERATION, COMMANDED_CURRENT, MOTOR_CURRENT)
"""Private topics of the controller: what the paper's block diagram has and the other topics do not."""
DETAIL_DECIMATION: Final = 10
"""Ticks of the position loop for each message of these."""
SAMPLED: Final = "sampled"
"""Namespace of the topics on which the simulation publishes its states for those who look on."""
SAMPLED_RATE: Final = 100
"""Of these, Hz of simulated time."""
MAX_DISPLAY_RTF: Final = 1.2
"""Simulated s in one of the wall clock above which those who look on are shown less: nobody paces what is faster."""
TIME_MODE: Final = "time_mode"
"""Latched by the simulation: how time is kept; the controller follows it."""
LOCK_STEP: Final = "lock_step"
FREE_RUNNING: Final = "free_running"
TIME_MODES: Final = (LOCK_STEP, FREE_RUNNING)
