"""The exchange of ticks between nodes over DDS: raw CDR, lock-step, pacing, and code shared by entry points."""
