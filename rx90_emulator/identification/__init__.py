"""From recorded bags to the friction of a robot, with standard deviations, a report and a validation.

Data flow: records (bags as joint-side series) -> sliding (tau_c, tau_s, omega_s, delta, c2) -> presliding (c0, c1,
kind of bristles) -> result (all elements, and the validation) -> output. The model (rigid arm, robot, estimates) is
shared by them; the experiments make bags. `identify.identify_friction` does it all, `job.write_identification` writes
what it returns;
`friction_check.check_friction` holds a given friction file against bags. `excitation.identify.identify_excitation`
needs no plateaus: runs of any shape give base parameters and friction, which `excitation_job.write_excitation` writes.
"""

__all__ = ["excitation_job", "friction_check", "identify", "job", "progress"]
