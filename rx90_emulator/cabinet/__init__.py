"""The cabinet below its language: the arm in its own values, motions one after the other, signals, power and time."""
