"""What an identification leaves behind: friction file, report, validation."""

__all__ = ["files", "friction_file", "report", "summary"]
