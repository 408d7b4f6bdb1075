"""Channels between processes and within one, on real DDS in one process; one publisher for each tick topic."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial

import pytest
from processes import on_own_domain, wait_until
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_client import Client
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from rx90_common.base.errors import ConfigError, ExchangeError
from rx90_common.base.share import ROOT
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Channel, LocalLink, TickChannel, lock_publisher
from rx90_common.exchange.endpoints import TICK_QOS, wait_until_matched

pytestmark = pytest.mark.ros
QOS = TICK_QOS
RAW = [JointStateCodec(["a"]).encode(tick) for tick in range(3)]
HOLD = """
import sys, time
from rx90_common.exchange.channel import lock_publisher
lock = lock_publisher(7, sys.argv[1])
print("held", flush=True)
time.sleep(60)
"""


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    logs = tmp_path_factory.mktemp("logs")
    with pytest.MonkeyPatch.context() as patch, on_own_domain(patch, logs), closing(Client()) as started:
        yield started


@pytest.mark.parametrize("counted", [True, False])
@pytest.mark.parametrize("timeout", [0.0, 0.001])
def test_bursts_are_received_whole(
    client: Client, timeout: float, counted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages that came while nobody looked are all received, in order, also where the middleware counts none."""
    if not counted:
        monkeypatch.setattr("rx90_common.exchange.channel.count_arrivals", lambda *_: False)
    topic = f"burst_{round(1000 * timeout)}_{counted}"
    with closing(Channel(client.node, f"{topic}_out", topic, QOS)) as channel:
        publisher = client.node.create_publisher(JointState, topic, QOS)
        wait_until(lambda: publisher.get_subscription_count() == 1, "the channel")
        received: list[bytes] = []
        for burst in (1, 7, 3):
            sent = len(received) + burst
            for number in range(len(received), sent):
                publisher.publish(JointState(name=[str(number)]))
            deadline = time.monotonic() + 60.0
            while len(received) < sent and time.monotonic() < deadline:
                raw = channel.receive(timeout)
                received += [raw] if raw is not None else []
            assert channel.receive(timeout) is None
    assert len(received) == 11
    assert [raw for number, raw in enumerate(received) if str(number).encode() + b"\0" not in raw] == []


def test_messages_come_in_order_and_from_the_peer_alone(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """The peer's messages arrive in order, published from the first match on; others are announced, not heard."""
    link = LocalLink()
    first = link.end(client.node, "states", "commands", QOS)
    second = link.end(client.node, "commands", "states", QOS)
    first.publish(RAW[0])  # nobody listens yet
    heard = client.listen("states")
    foreign = client.node.create_publisher(JointState, "commands", QOS)
    client.spin_until(lambda: first.publisher.get_subscription_count() == 1, "the listener")
    client.spin_until(lambda: client.node.count_publishers("commands") == 2, "the other publisher")
    foreign.publish(RAW[2])
    first.publish(RAW[1])
    first.publish(RAW[2])
    client.spin_until(lambda: len(heard) == 2, "what was sent since")
    assert [second.receive(0.0) for _ in range(4)] == [*RAW, None]
    assert first.receive(0.05) is None
    said: list[str] = []
    monkeypatch.setattr(type(client.node.get_logger()), "warning", lambda _, text: said.append(text))
    for _ in range(20):
        first.look_for_others()
        second.look_for_others()
    assert len(said) == 1
    assert said[0].startswith("1 other publishes on /commands: not heard")
    first.close()
    second.close()


def test_a_wait_ends_with_a_message_or_a_wake(client: Client) -> None:
    """Who waits gets what another thread sends, and nothing when woken; late announcements of messages end no wait."""
    link = LocalLink()
    first = link.end(client.node, "waited_states", "waited_commands", QOS)
    second = link.end(client.node, "waited_commands", "waited_states", QOS)
    assert waited_for(second, lambda: first.publish(RAW[0])) == RAW[0]
    assert waited_for(second, second.wake) is None
    second._arrived.set()
    began = time.monotonic()
    assert second.receive(0.05) is None
    assert time.monotonic() - began >= 0.05


def waited_for(end: TickChannel, act: Callable[[], object]) -> bytes | None:
    got: list[bytes | None] = []
    thread = threading.Thread(target=lambda: got.append(end.receive(30.0)))
    thread.start()
    time.sleep(0.02)  # it most likely waits by then
    act()
    thread.join(20.0)
    (received,) = got
    return received


@pytest.mark.parametrize("polls", [True, False])
def test_a_dds_wait_ends_with_a_message_or_a_wake(client: Client, monkeypatch: pytest.MonkeyPatch, polls: bool) -> None:
    """So does who waits over DDS, while it polls and while it sleeps; a wait in vain takes its time, asleep."""
    monkeypatch.setattr("rx90_common.exchange.channel._BUSY_WAIT_NS", 10**11 if polls else 0)
    topics = f"dds_states_{polls}", f"dds_commands_{polls}"
    with (
        closing(Channel(client.node, *topics, QOS)) as first,
        closing(Channel(client.node, *topics[::-1], QOS)) as second,
    ):
        wait_until(lambda: first.matches().subscriptions == second.matches().publishers == 1, "the other end")
        for raw in RAW[:2]:
            assert waited_for(second, partial(first.publish, raw)) == raw
        if not polls:
            assert waited_for(second, second.wake) is None
            began, worked = time.monotonic(), time.thread_time()
            assert second.receive(0.2) is None
            assert time.monotonic() - began >= 0.2
            assert time.thread_time() - worked < 0.1


def test_ends_that_do_not_meet_are_refused(client: Client) -> None:
    """A remap or a namespace of one node alone is named with both topics; a second pair on the same ones is refused."""
    link = LocalLink()
    link.end(client.node, "met_states", "met_commands", QOS)
    with pytest.raises(ConfigError, match=r"publishes /met_states, .* receives /other; accepted: the same"):
        link.end(client.node, "met_commands", "other", QOS)
    with pytest.raises(ExchangeError, match=f"/met_states in ROS_DOMAIN_ID .* by process {os.getpid()}; accepted: one"):
        LocalLink().end(client.node, "met_states", "met_commands", QOS)


def test_a_subscriber_that_never_fits_is_not_waited_for(client: Client) -> None:
    """A subscriber that asks for more than is offered does not keep the others waiting."""
    client.listen("fitting")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    client.node.create_subscription(JointState, "fitting", lambda _message: None, latched)
    publisher = client.node.create_publisher(JointState, "fitting", 10)
    client.spin_until(lambda: client.node.count_subscribers("fitting") == 2, "both in the graph")
    assert wait_until_matched(client.node, [publisher], 200)
    assert publisher.get_subscription_count() == 1


def test_a_call_leaves_no_client_behind(client: Client) -> None:
    """Each client that is left makes every later wait longer: that of a call goes with its answer."""
    client.node.create_service(Trigger, "asked", lambda _, answer: answer)
    before = list(client.node.clients)
    client.asking.call(Trigger, "asked", Trigger.Request())
    assert list(client.node.clients) == before


@pytest.mark.usefixtures("warm")
def test_a_lock_goes_with_the_process_that_holds_it() -> None:
    """A topic held by another process is refused with its process id, and free as soon as that was killed."""
    topic = f"/test_{os.getpid()}/motor_states"
    holder = subprocess.Popen([sys.executable, "-c", HOLD, topic], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
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


def test_a_lock_holds_one_topic_of_one_domain() -> None:
    """Other topics and domains are free, also with names longer than the kernel's limit; it ends when it is closed."""
    topic = f"/test_{os.getpid()}/motor_states" + "/namespace" * 30
    others = lock_publisher(7, topic), lock_publisher(7, topic + "2")
    with lock_publisher(8, topic), pytest.raises(ExchangeError):
        lock_publisher(8, topic)
    for lock in (*others, lock_publisher(8, topic)):
        lock.close()
