"""Bags: recorded from the running nodes, written from arrays, read back, summarised and compared."""

__all__ = [
    "batch",
    "changes",
    "comparison",
    "decoding",
    "joint_series",
    "ordering",
    "reading",
    "robot_name",
    "summary",
    "tables",
    "tolerance",
    "topics",
    "trajectories",
    "writing",
]
