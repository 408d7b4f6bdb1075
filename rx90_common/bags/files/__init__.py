"""The storage files of bags: mcap, sqlite3, ROS 1; index, counts and checksums are held against the messages."""

__all__ = ["contents", "mcap_writing", "opening"]
