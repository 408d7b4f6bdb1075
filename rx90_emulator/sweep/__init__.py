"""Many runs of the closed loop over a plan of parameters, into one Parquet file."""

__all__ = ["execution", "info", "metrics", "plan", "plan_file", "report", "spaces", "sweep"]
