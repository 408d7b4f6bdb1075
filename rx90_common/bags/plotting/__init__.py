"""The joint states of one or two bags as a picture, or as a page in which they are zoomed."""

__all__ = ["plotting"]
