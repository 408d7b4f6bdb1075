"""The nodes and clients that the tests of the action share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest
from action_bench import PAUSED, UNPACED, Bench
from numpy.typing import NDArray
from processes import on_own_domain, running_processes
from ros_client import Client
from warm_start import WarmPopen

from rx90_emulator.loop.setup import Setup


@pytest.fixture(scope="package")
def bench(needs_action: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:  # noqa: ARG001 - it must be there
    """Give both nodes, in one process, with time standing still."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setattr("subprocess.Popen", WarmPopen)
        stack.enter_context(on_own_domain(patch, tmp_path_factory.mktemp("action")))
        processes = stack.enter_context(running_processes())
        cell = processes.start("rx90_cell", "--ros-args", *PAUSED, *UNPACED)
        yield Bench(stack.enter_context(closing(Client())), cell)


@pytest.fixture
def acceleration(shipped: Setup) -> NDArray[np.float64]:
    """Return the limits of the joints' accelerations, rad/s^2, with what rounding adds."""
    return shipped.controller.limits(shipped.robot).acceleration * (1.0 + 1e-9) + 1e-9
