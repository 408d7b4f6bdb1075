"""Bags: recorded from the running nodes, written from arrays, read back, summarised and compared."""

__all__ = [
    "batch",
    "changes",
    "comparison",
    "decoding",
    "exporting",
    "importing",
    "joint_series",
    "mapping",
    "ordering",
    "plotting",
    "reading",
    "robot_name",
    "summary",
    "tables",
    "time_shift",
    "tolerance",
    "topics",
    "trajectories",
    "writing",
]
