"""Random friction of an arm of this project, for measurements of the identification."""

from __future__ import annotations

import numpy as np

from rx90_common.friction import FrictionElement, FrictionSet


def random_friction(base: FrictionSet, rng: np.random.Generator) -> FrictionSet:
    """Return elements with every parameter moved at random, each sign of the velocity by itself."""
    elements = []
    for name, element in zip(base.names, base.elements, strict=True):
        up, down = rng.uniform(0.7, 1.4, 2) * element.tau_c.positive
        if name == "joint_5_6":
            down = up  # the difference is a constant torque that joints 5 and 6 may as well have
        rise = rng.uniform(0.2, 0.5, 2)
        elements.append(
            FrictionElement(
                tau_c={"positive": up, "negative": down},
                tau_s={"positive": up * (1 + rise[0]), "negative": down * (1 + rise[1])},
                omega_s=element.omega_s * rng.uniform(0.7, 1.5),
                delta=rng.uniform(0.8, 1.8),
                c0=element.c0,
                c1=element.c1,
                c2=element.c2 * rng.uniform(0.6, 1.5),
            )
        )
    return FrictionSet(base.names, tuple(elements))
