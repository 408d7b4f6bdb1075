"""How nodes exchange ticks over DDS: raw CDR, the lock-step, pacing, and what entry points share."""

__all__ = [
    "arrivals",
    "cdr_reader",
    "channel",
    "client_node",
    "environment",
    "joint_state_cdr",
    "listeners",
    "local_link",
    "lockstep",
    "motor_messages",
    "node_tools",
    "pacing",
    "qos",
    "qos_overrides",
    "ros_start",
    "subscribing",
    "throttle",
    "tick_channel",
    "time_mode",
    "topics",
]
