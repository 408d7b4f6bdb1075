"""What both nodes must agree on: names of topics and motors, and the quality of service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

MOTOR_NAMES: Final = tuple(f"motor_{i}" for i in range(1, 7))
MOTOR_STATES: Final = "motor_states"
MOTOR_COMMANDS: Final = "motor_commands"
REFERENCE_ACCELERATION: Final = "reference_acceleration"
COMMANDED_CURRENT: Final = "commanded_current"
MOTOR_CURRENT: Final = "motor_current"
DETAILS: Final = (REFERENCE_ACCELERATION, COMMANDED_CURRENT, MOTOR_CURRENT)
"""Private topics of the controller: what the paper's block diagram has and the other topics do not."""
DETAIL_DECIMATION: Final = 10
"""Ticks of the position loop for each message of these."""
TIME_MODE: Final = "time_mode"
"""Latched by the simulation: how time is kept; the controller follows it."""
LOCK_STEP: Final = "lock_step"
FREE_RUNNING: Final = "free_running"
TIME_MODES: Final = (LOCK_STEP, FREE_RUNNING)


class Reliable(NamedTuple):
    """A reliable quality of service that keeps `depth` messages, `latched` also for subscribers that come later."""

    depth: int
    latched: bool = False

    @property
    def profile(self) -> QoSProfile:
        """Return it as rclpy has it."""
        # Here, because the names are of use without ROS.
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        durability = DurabilityPolicy.TRANSIENT_LOCAL if self.latched else DurabilityPolicy.VOLATILE
        return QoSProfile(depth=self.depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)


# Deep enough that a recorder which does not run for a second loses nothing. KEEP_ALL would stop the tick instead, for
# as long as the lease of a recorder that was killed.
TICK_QOS: Final = Reliable(8000)
STATE_QOS: Final = Reliable(2000)
CLOCK_QOS: Final = Reliable(10)
LATCHED_QOS: Final = Reliable(1, latched=True)
# A burst is answered one by one, each with a line of its own; planning takes longer than sending.
TRAJECTORY_QOS: Final = Reliable(1000)
