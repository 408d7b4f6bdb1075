"""Keeps the line to a rig alive on a thread: connects, listens, reconnects, reports each trouble once."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future

from friction_bench.rig.client import SWITCHED_ON, Port, RigClient, Sample
from friction_bench.rig.messages import (
    Fault,
    Report,
    RigError,
    RigLostError,
    RigResetError,
    fault_text,
)
from friction_bench.rig.rig_file import Rig

OWNER_SILENCE = 0.1
"""Heartbeats stop when the owner has not called `alive` for so long, s, as a hung program must not keep the rig on."""
BACKOFF = (0.25, 0.5, 1.0, 2.0)
DAMAGE_LIMIT = 3
"""So many damaged or missing frames within DAMAGE_WINDOW seconds disarm the rig."""
DAMAGE_WINDOW = 1.0
CALM = 2.0
"""The line is good again after so long without trouble, s; until then no kind of trouble is reported twice."""
_DISTURBED = "the line is disturbed"
"""One kind of trouble for noise, a loose cable and a second reader, whose symptoms alternate."""


class RigLink:
    """One rig on one port. Each kind of trouble is reported once until the line has been good for CALM seconds.

    Args:
        open_port: opens the port; called again after a loss.
        rig: the expected rig.
        on_sample: called with each reading, on the link's thread.
        on_trouble: called with one line for each trouble, on the link's thread.
        on_good: called with one line when the rig answers (again) and the line is good.

    Attributes:
        client: of the present connection, None without one.
    """

    def __init__(
        self,
        open_port: Callable[[], Port],
        rig: Rig,
        on_sample: Callable[[Sample], None],
        on_trouble: Callable[[str], None],
        on_good: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.rig = rig
        self.client: RigClient | None = None
        self._open_port = open_port
        self._on_sample = on_sample
        self._on_trouble = on_trouble
        self._on_good = on_good
        self._reported: set[str] = set()
        self._troubled_at = 0.0
        self._last_fault = Fault.NONE
        self._greeting = ""  # argument of `on_good` once the line is good
        self._jobs: queue.Queue[tuple[Callable[[RigClient], None], Future[None], int]] = (
            queue.Queue()
        )
        self._jobs_lock = threading.Lock()  # a job is queued for a connection that there is
        self._closed = threading.Event()
        self._alive_at = time.monotonic()
        self._port: Port | None = None
        self._damage_times: deque[float] = deque()
        self._seen_damage = 0
        self._past = (0, 0)  # bad frames and lost reports of earlier connections

    @property
    def connected(self) -> bool:
        """Return whether the rig has been greeted and talks."""
        client = self.client
        return client is not None and client.hello is not None

    @property
    def last(self) -> Report | None:
        """Return the latest report, None without a connection."""
        client = self.client
        # once: the link's thread forgets it at a reset
        last = None if client is None else client.last
        return None if last is None else last.report

    @property
    def damage(self) -> tuple[int, int]:
        """Return the damaged frames and the lost reports of all connections."""
        client = self.client
        bad, lost = self._past
        return (
            (bad, lost) if client is None else (bad + client.bad_frames, lost + client.lost_reports)
        )

    def alive(self) -> None:
        """Say that the owner is alive; without it the heartbeats stop and the rig switches itself off."""
        self._alive_at = time.monotonic()

    def submit(self, run: Callable[[RigClient], None]) -> Future[None]:
        """Call `run` with the client on the link's thread; its error comes out of the future.

        A job belongs to the connection on which it was submitted: it is never run after a loss or a reset of the
        rig, nor once its future has been cancelled.
        """
        future: Future[None] = Future()
        with self._jobs_lock:
            client = self.client
            if client is not None and client.hello is not None:
                self._jobs.put((run, future, client.stops))
            else:
                future.set_exception(RigLostError("there is no connection to the rig"))
        return future

    def stop_rig(self) -> None:
        """Take the torque away now: from any thread, before anything that is queued or under way.

        Raises:
            RigLostError: if there is no line to send it on; the firmware's watchdog then does it.
        """
        client = self.client
        if client is None:
            raise RigLostError("there is no connection to the rig; its watchdog switches it off")
        client.urgent_stop()

    def close(self) -> None:
        """End `run` soon."""
        self._closed.set()

    def run(self) -> None:
        """Serve the rig until `close`."""
        attempt = 0
        while not self._closed.is_set():
            try:
                self._port = self._open_port()
                self.client = RigClient(self._port, self.rig)
                self._serve(self.client)
                return
            except RigError as error:
                attempt = 0 if self.connected else attempt + 1
                disturbed = isinstance(error, RigLostError) and self._port is not None
                self._report(str(error), _DISTURBED if disturbed else "")
            finally:
                self._drop()
            self._closed.wait(BACKOFF[min(attempt, len(BACKOFF) - 1)])

    def _report(self, text: str, kind: str = "") -> None:
        """Report a trouble, unless one of its kind has been since the line was good."""
        self._troubled_at = time.monotonic()
        if (kind or text) not in self._reported:
            self._reported.add(kind or text)
            self._on_trouble(text)

    def _drop(self) -> None:
        client = self.client
        damage = self.damage
        with self._jobs_lock:
            self.client = None
            self._past = damage
            self._refuse_jobs("the connection to the rig was lost")
        port = self._port
        self._port = None
        if client is not None:
            with contextlib.suppress(RigError):
                client.urgent_stop()
        if port is not None:
            port.close()

    def _refuse_jobs(self, reason: str) -> None:
        """Refuse the waiting requests, with the lock held; none is added before a client has been greeted."""
        while not self._jobs.empty():
            _, future, _ = self._jobs.get_nowait()
            if future.set_running_or_notify_cancel():
                future.set_exception(RigLostError(reason))

    def _serve(self, client: RigClient) -> None:
        self._greet(client)
        while not self._closed.is_set():
            if time.monotonic() - self._troubled_at > CALM:
                self._reported.clear()
            if self._greeting and not self._reported:
                self._on_good(self._greeting)
                self._greeting = ""
            client.beating = time.monotonic() - self._alive_at < OWNER_SILENCE
            try:
                for sample in client.pump():
                    self._on_sample(sample)
                    fault = sample.report.fault
                    before = self._last_fault
                    self._last_fault = fault
                    if fault and fault != before:
                        self._on_trouble(
                            f"the rig switched itself off: {fault_text(fault)}; clear and arm it"
                        )
                self._watch_damage(client)
                self._run_next_job(client)
            except RigResetError as error:  # the client has forgotten its greeting
                with self._jobs_lock:
                    self._refuse_jobs(str(error))
                self._report(str(error))
                self._greet(client)

    def _greet(self, client: RigClient) -> None:
        hello = client.connect()
        self._seen_damage = client.bad_frames + client.lost_reports
        self._greeting = f"rig connected, {hello.text}"

    def _run_next_job(self, client: RigClient) -> None:
        try:
            run, future, client.known_stops = self._jobs.get_nowait()
        except queue.Empty:
            return
        if future.set_running_or_notify_cancel():
            try:
                run(client)
                future.set_result(None)
            except RigError as error:
                future.set_exception(error)
                if isinstance(error, RigLostError | RigResetError):
                    raise
        client.known_stops = client.stops

    def _watch_damage(self, client: RigClient) -> None:
        now = time.monotonic()
        times = self._damage_times
        damage = client.bad_frames + client.lost_reports
        fresh = damage - self._seen_damage
        self._seen_damage = damage
        times.extend([now] * min(fresh, DAMAGE_LIMIT))
        while times and now - times[0] > DAMAGE_WINDOW:
            times.popleft()
        # What disarmed the rig once must not do so again when it is armed; and one stop is enough, it is repeated.
        if fresh and len(times) >= DAMAGE_LIMIT:
            self._report("garbage on the line to the rig; it is disarmed", _DISTURBED)
            if (
                client.last is not None
                and client.last.report.state in SWITCHED_ON
                and not client.stopping
            ):
                client.urgent_stop()
                client.known_stops = client.stops
