"""The perturbation method: deviations from a nominal motion, linear in the arm, non-linear in the friction."""
