"""How nodes exchange ticks over DDS: raw CDR, the lock-step, pacing, and what entry points share."""

__all__ = [
    "cdr_reader",
    "channel",
    "client_node",
    "environment",
    "joint_state_cdr",
    "lockstep",
    "motor_messages",
    "node_tools",
    "pacing",
    "parameter_services",
    "qos_overrides",
    "ros_start",
    "subscribing",
    "throttle",
    "time_mode",
    "topics",
]
