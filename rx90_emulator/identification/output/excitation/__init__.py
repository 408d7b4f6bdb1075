"""What an identification from excitation runs writes: report with plots, parameters, summary for the terminal."""

__all__ = ["parameters_file", "report", "robot", "summary"]
