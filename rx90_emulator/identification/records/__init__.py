"""What was recorded, by which robot: bags read into series that an estimate can use."""

__all__ = ["foreign_urdf", "reading", "record", "robot", "spikes", "tolerances"]
