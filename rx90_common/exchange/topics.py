"""Names that both nodes must agree on."""

from __future__ import annotations

from typing import Final

MOTOR_NAMES: Final = tuple(f"motor_{i}" for i in range(1, 7))
MOTOR_STATES: Final = "motor_states"
MOTOR_COMMANDS: Final = "motor_commands"
TIME_MODE: Final = "time_mode"
"""Latched by the simulation: how time is kept; the controller follows it."""
LOCK_STEP: Final = "lock_step"
FREE_RUNNING: Final = "free_running"
TIME_MODES: Final = (LOCK_STEP, FREE_RUNNING)
