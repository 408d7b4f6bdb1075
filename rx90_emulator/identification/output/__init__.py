"""What an identification writes: friction file, report with plots, summary for the terminal."""

__all__ = ["files", "friction_file", "report", "summary"]
