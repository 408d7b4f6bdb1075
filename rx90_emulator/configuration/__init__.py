"""The project's configuration files as a whole: which kinds there are, what is wrong in them, what they come to."""

__all__ = ["check", "friction_comparison", "friction_sets", "node_values", "origins", "showing"]
