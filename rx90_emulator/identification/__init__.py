"""From recorded bags to the friction of a robot, with standard deviations, a report and a validation.

Data flow: records (bags as joint-side series) -> sliding (tau_c, tau_s, omega_s, delta, c2) -> presliding (c0, c1)
-> identify (all elements) -> validation -> output. The modules beside these folders (arm, robot,
estimates, checks) are shared by all steps; `experiments` plans motions and records bags. `identify.identify_friction`
runs all steps, `identify.check_friction` compares a given friction file with bags, and `job` writes their results.
`excitation.identify.identify_excitation` needs no plateaus of constant velocity: it identifies base parameters and
friction from runs of any shape. `validation.measured.compare_measured` compares a measured run with the closed loop
along its path.
"""
