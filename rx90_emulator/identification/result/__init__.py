"""What is known of each parameter of the identified elements."""

__all__ = ["identification"]
