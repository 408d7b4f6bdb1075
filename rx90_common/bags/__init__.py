"""Bags: recorded from the running nodes, written from arrays, read back, summarised and compared."""

__all__ = [
    "batch",
    "block_writing",
    "changes",
    "comparison",
    "decoding",
    "joint_series",
    "ordering",
    "reading",
    "robot_name",
    "storage",
    "summary",
    "tables",
    "time_shift",
    "tolerance",
    "topics",
    "trajectories",
    "writing",
]
