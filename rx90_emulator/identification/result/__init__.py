"""The identified friction of all elements, and its validation on bags that were not used."""

__all__ = ["identification", "validation"]
