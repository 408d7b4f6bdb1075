"""Many runs of the closed loop over a plan of parameters, into one Parquet file."""
