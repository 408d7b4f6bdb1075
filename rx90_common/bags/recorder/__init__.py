"""The recorder: messages received from DDS unchanged, counted, and written in order."""
