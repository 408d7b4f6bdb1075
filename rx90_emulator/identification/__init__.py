"""From recorded bags to the friction parameters of a robot, with their uncertainty and a cross-check."""

__all__ = ["identify", "job"]
