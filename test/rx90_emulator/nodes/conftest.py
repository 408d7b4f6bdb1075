"""A ROS client in the test process, on the test's own domain."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest
from ros_client import Client


@pytest.fixture
def client(ros_domain: int) -> Iterator[Client]:  # noqa: ARG001 - a domain of its own
    """Give a client on the test's domain."""
    with closing(Client()) as started:
        yield started
