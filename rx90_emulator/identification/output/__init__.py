"""What an identification, or a comparison with a measured run, writes: files, reports, summaries for the terminal."""

__all__ = ["excitation_report", "friction_file", "parameters_file", "report", "robot_files"]
