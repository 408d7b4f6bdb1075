"""Base parameters: fewer numbers, the same arm."""

from __future__ import annotations

import numpy as np
import pytest

from rx90_common.dynamics import base_parameters
from rx90_emulator.loop.setup import Setup


def test_mass_on_a_joint_axis_is_the_link_s_before_it(shipped: Setup) -> None:
    """Moving a point mass on an axis from one link to the link before leaves every base parameter as it was."""
    chain = shipped.robot.chain
    want = base_parameters(chain)
    for i in range(1, 6):
        # The mass and what it adds to both links, about their own centres of mass.
        extra, place = 3.0, 0.2 * chain.axis[i]
        mass, com, inertia = chain.mass.copy(), chain.com.copy(), chain.inertia.copy()
        for link, sign, point in ((i, -1, place), (i - 1, 1, chain.origin[i] + place)):
            total = mass[link] + sign * extra
            apart = point - com[link]
            reduced = sign * extra * mass[link] / total
            tensor = reduced * (apart @ apart * np.eye(3) - np.outer(apart, apart))
            inertia[link] += [*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]]
            com[link] = (mass[link] * com[link] + sign * extra * point) / total
            mass[link] = total
        got = base_parameters(chain._replace(mass=mass, com=com, inertia=inertia))
        for name in ("first_moment", "second_moment", "frame", "next_origin"):
            assert getattr(got, name) == pytest.approx(getattr(want, name), abs=1e-9)


def test_frames_are_rotations_about_the_joint_axes(shipped: Setup) -> None:
    """Chained from the base, each frame is a right-handed rotation whose z is the joint axis."""
    chain = shipped.robot.chain
    orientation = np.eye(3)
    for frame, axis in zip(base_parameters(chain).frame, chain.axis, strict=True):
        orientation = orientation @ frame
        assert orientation.T @ orientation == pytest.approx(np.eye(3), abs=1e-14)
        assert np.linalg.det(orientation) == pytest.approx(1.0)
        assert orientation[:, 2] == pytest.approx(axis, abs=1e-14)
