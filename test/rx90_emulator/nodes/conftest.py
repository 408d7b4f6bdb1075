"""A ROS client in the test process, on the test's own domain."""

from collections.abc import Iterator
from contextlib import closing

import pytest
from ros_client import Client


@pytest.fixture
def client(ros_domain: int) -> Iterator[Client]:  # noqa: ARG001 - a domain of its own
    with closing(Client()) as started:
        yield started
