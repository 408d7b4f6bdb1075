"""The commands, one file for each, in one frame that turns what goes wrong into one line and an exit code."""
