"""What instructions of V+ act on: the arm in V+'s values, motions, signals, power, time, and the record of a run."""
