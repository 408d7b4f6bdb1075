"""From recorded bags to the friction of a robot, with standard deviations, a report and a validation.

Data flow: records (bags as joint-side series) -> sliding (tau_c, tau_s, omega_s, delta, c2) -> presliding (c0, c1,
kind of bristles) -> identify (all elements) -> validation -> output. What the steps share (arm, robot, estimates,
zeros) stands beside them; the experiments make bags. `identify.identify_friction` does it all,
`identify.check_friction` holds a given friction file against bags, and `job` writes what they return.
`excitation.identify.identify_excitation` needs no plateaus: runs of any shape give base parameters and friction.
`validation.measured.compare_measured` holds a measured run against the closed loop along its path.
"""
