"""A robot's friction and its arm in the formats of other simulators, and back, with the differences in Nm."""
