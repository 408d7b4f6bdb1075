"""A friction element whose torques differ by the sign of the velocity, for tests of bristles."""

from rx90_common.friction import FrictionElement

ELEMENT = FrictionElement(
    tau_c={"positive": 25.0, "negative": 31.0},
    tau_s={"positive": 32.0, "negative": 47.0},
    omega_s=0.05,
    delta=1.0,
    c0=1e5,
    c1=100.0,
    c2=14.0,
    omega_d=1.0,
)
