"""The series of a bag as tables for other programs: CSV, Parquet, NPZ with names that MATLAB takes."""

__all__ = ["exporting"]
