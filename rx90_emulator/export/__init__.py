"""A robot's friction and its arm in the formats of other simulators, with the differences in Nm."""
