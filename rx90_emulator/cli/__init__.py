"""The commands, in one frame that turns every error into one line and an exit code."""
