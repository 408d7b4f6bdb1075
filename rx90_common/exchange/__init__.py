"""How nodes exchange ticks over DDS: raw CDR, the lock-step, pacing, and what entry points share."""
