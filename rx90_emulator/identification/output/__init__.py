"""What an identification leaves behind: friction file, report, validation."""

__all__ = ["friction_file", "output_files", "report", "summary", "validation", "validation_run"]
