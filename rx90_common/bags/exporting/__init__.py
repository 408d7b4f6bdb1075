"""The joint states of a bag as tables for other programs: CSV, Parquet, and NPZ with names that MATLAB takes."""

__all__ = ["exporting"]
