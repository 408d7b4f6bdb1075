"""One publisher for each tick topic of a machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.publisher_lock import lock_publisher

ROOT = Path(__file__).parents[3]
HOLD = """
import sys, time
from rx90_common.exchange.publisher_lock import lock_publisher
lock = lock_publisher(7, sys.argv[1])
print("held", flush=True)
time.sleep(60)
"""


@pytest.fixture
def topic() -> str:
    """Return a name that no other run of the tests uses."""
    return f"/test_{os.getpid()}/motor_states"


def test_a_lock_goes_with_the_process_that_holds_it(topic: str) -> None:
    """A topic held by another process is refused with its process id, and free as soon as that was killed."""
    holder = subprocess.Popen([sys.executable, "-c", HOLD, topic], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(ExchangeError) as caught:
            lock_publisher(7, topic)
        for part in (topic, "ROS_DOMAIN_ID 7", f"process {holder.pid};", "accepted: one publisher"):
            assert part in str(caught.value)
        holder.send_signal(signal.SIGKILL)
        holder.wait(30)
        lock_publisher(7, topic).close()
    finally:
        holder.kill()
        holder.wait(30)


def test_other_topics_and_domains_are_free(topic: str) -> None:
    """A lock holds one topic of one domain, and ends when it is closed."""
    others = lock_publisher(7, topic), lock_publisher(7, topic + "_other")
    with lock_publisher(8, topic), pytest.raises(ExchangeError):
        lock_publisher(8, topic)
    for other in others:
        other.close()
    lock_publisher(8, topic).close()


def test_long_names_are_told_apart(topic: str) -> None:
    """Names longer than the kernel's limit for sockets are locked whole."""
    long = topic + "/namespace" * 30
    with lock_publisher(7, long + "1"), lock_publisher(7, long + "2"), pytest.raises(ExchangeError):
        lock_publisher(7, long + "1")
