"""What was recorded, by which robot: bags read into series that an estimate can use."""

__all__ = ["layout", "reading", "record"]
