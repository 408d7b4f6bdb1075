"""Keeps the line to a rig alive on a thread: connects, listens, reconnects, reports each trouble once."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

from friction_bench.protocol.errors import RigError, RigLostError, RigResetError
from friction_bench.protocol.messages import Fault, Report, State, fault_text
from friction_bench.rig.client import Port, RigClient, Sample
from friction_bench.rig.rig_file import Rig

OWNER_SILENCE = 0.1
"""Heartbeats stop when the owner has not called `alive` for so long, s: a hung program is a dead host."""
BACKOFF = (0.25, 0.5, 1.0, 2.0)
DAMAGE_LIMIT = 3
"""So many damaged or missing frames within DAMAGE_WINDOW seconds disarm the rig."""
DAMAGE_WINDOW = 1.0
CALM = 2.0
"""So long without trouble, s, and the line is good again: until then nothing is reported a second time."""
_DISTURBED = "the line is disturbed"
"""One trouble, whatever shows it: noise, a cable, or a second reader, which is now the one and now the other."""


@dataclass(frozen=True)
class _Job:
    """What the owner wants done, and how many stops it knew of when it said so."""

    run: Callable[[RigClient], None]
    future: Future[None]
    stops: int


class RigLink:
    """One rig on one port.

    Args:
        open_port: opens the line; called again after a loss.
        rig: what is expected at its end.
        on_sample: called with each reading, on the link's thread.
        on_trouble: called with one line for each trouble, on the link's thread.
        on_good: called with one line when the rig answers (again) and the line is good.
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
        self._open_port = open_port
        self._on_sample = on_sample
        self._on_trouble = on_trouble
        self._on_good = on_good
        self._jobs: queue.Queue[_Job] = queue.Queue()
        self._closed = threading.Event()
        self._alive_at = time.monotonic()
        self._port: Port | None = None
        self._told: set[str] = set()
        self._troubled_at = 0.0
        self._greeted = ""  # what `on_good` has still to be told
        self._last_fault = Fault.NONE
        self._damage: deque[float] = deque()
        self._submitting = threading.Lock()
        self._seen_damage = 0
        self.client: RigClient | None = None
        self.bad_frames = 0
        self.lost_reports = 0

    @property
    def connected(self) -> bool:
        """Return whether the rig has been greeted and talks."""
        client = self.client
        return client is not None and client.hello is not None

    @property
    def last(self) -> Report | None:
        """Return the latest report, None without a connection."""
        client = self.client
        return client.last.report if client is not None and client.last is not None else None

    def alive(self) -> None:
        """Say that the owner is alive; without it the heartbeats stop and the rig switches itself off."""
        self._alive_at = time.monotonic()

    def submit(self, job: Callable[[RigClient], None]) -> Future[None]:
        """Run `job` with the client on the link's thread; its error comes out of the future.

        A job belongs to the connection on which it was submitted: it is never run after a loss or a reset of the
        rig, nor once its future has been cancelled.
        """
        future: Future[None] = Future()
        with self._submitting:
            client = self.client
            if client is not None and client.hello is not None:
                self._jobs.put(_Job(job, future, client.stops))
                return future
        future.set_exception(RigLostError("there is no connection to the rig"))
        return future

    def stop_rig(self) -> None:
        """Take the torque away now: from any thread, before anything that is queued or under way.

        Raises:
            RigLostError: if there is no line to say it on; the firmware's watchdog then does it.
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
                self._serve(RigClient(self._port, self.rig))
                return
            except RigError as error:
                attempt = 0 if self.connected else attempt + 1
                disturbed = isinstance(error, RigLostError) and self._port is not None
                self._trouble(str(error), _DISTURBED if disturbed else str(error))
            finally:
                self._drop()
            self._closed.wait(BACKOFF[min(attempt, len(BACKOFF) - 1)])

    def _drop(self) -> None:
        with self._submitting:
            client, self.client, port, self._port = self.client, None, self._port, None
            self._refuse_jobs("the connection to the rig was lost")
        if client is not None:
            self.bad_frames += client.bad_frames
            self.lost_reports += client.lost_reports
        if port is not None:
            with contextlib.suppress(RigError):
                if client is not None:
                    client.urgent_stop()
            port.close()

    def _refuse_jobs(self, reason: str) -> None:
        while not self._jobs.empty():
            future = self._jobs.get_nowait().future
            if future.set_running_or_notify_cancel():
                future.set_exception(RigLostError(reason))

    def _trouble(self, text: str, kind: str) -> None:
        """Report a trouble, unless one of its kind has been since the line was good."""
        self._troubled_at = time.monotonic()
        if kind not in self._told:
            self._told.add(kind)
            self._on_trouble(text)

    def _watch_calm(self) -> None:
        if self._told and time.monotonic() - self._troubled_at > CALM:
            self._told.clear()
        if self._greeted and not self._told:
            self._on_good(self._greeted)
            self._greeted = ""

    def _serve(self, client: RigClient) -> None:
        self.client = client
        self._greet(client)
        while not self._closed.is_set():
            self._watch_calm()
            client.beating = time.monotonic() - self._alive_at < OWNER_SILENCE
            try:
                self._step(client)
            except RigResetError as error:
                with self._submitting:  # the client has forgotten its greeting: nothing is added meanwhile
                    self._refuse_jobs(str(error))
                self._trouble(str(error), str(error))
                self._greet(client)

    def _greet(self, client: RigClient) -> None:
        hello = client.connect()
        self._seen_damage = client.bad_frames + client.lost_reports
        self._greeted = f"rig connected, reset cause {hello.reset_cause}, firmware target {hello.target}"

    def _step(self, client: RigClient) -> None:
        for sample in client.pump():
            self._on_sample(sample)
            self._watch_fault(sample.report)
        self._watch_damage(client)
        try:
            job = self._jobs.get_nowait()
        except queue.Empty:
            return
        if not job.future.set_running_or_notify_cancel():
            return
        client.permitted = job.stops
        try:
            job.run(client)
        except (RigLostError, RigResetError) as error:
            job.future.set_exception(error)
            raise
        except RigError as error:
            job.future.set_exception(error)
        else:
            job.future.set_result(None)
        client.permitted = client.stops

    def _watch_fault(self, report: Report) -> None:
        if report.fault != self._last_fault:
            self._last_fault = report.fault
            if report.fault:
                self._on_trouble(f"the rig switched itself off: {fault_text(report.fault)}; clear and arm it")

    def _watch_damage(self, client: RigClient) -> None:
        now = time.monotonic()
        damage = client.bad_frames + client.lost_reports
        fresh, self._seen_damage = damage - self._seen_damage, damage
        self._damage.extend([now] * min(fresh, DAMAGE_LIMIT))
        while self._damage and now - self._damage[0] > DAMAGE_WINDOW:
            self._damage.popleft()
        # What disarmed the rig once must not do so again when it is armed; and one stop is enough, it is repeated.
        if fresh and len(self._damage) >= DAMAGE_LIMIT:
            self._trouble("garbage on the line to the rig; it is disarmed", _DISTURBED)
            armed = client.last is not None and client.last.report.state in {State.ARMED, State.RAMPING}
            if armed and not client.stopping:
                client.urgent_stop()
                client.permitted = client.stops
