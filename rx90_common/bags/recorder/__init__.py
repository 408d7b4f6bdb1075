"""The recorder: messages taken from DDS as they are, counted, and written in order."""
