"""Many runs of the closed loop over a plan of parameters, into one Parquet file."""

__all__ = ["info", "plan_file", "running", "sweep"]
