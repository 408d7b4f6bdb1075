"""Keeps the line to a rig alive on a thread: connects, listens, reconnects, reports a lasting trouble once."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

from friction_bench.rig.client import Port, RigClient, Sample
from friction_bench.rig.messages import (
    Fault,
    RigError,
    RigLostError,
    RigResetError,
    fault_text,
)
from friction_bench.rig.rig_file import Rig

OWNER_SILENCE = 0.1
"""Heartbeats stop when the owner has not called `alive` for so long, s, as a hung program must not keep the rig on."""
RETRY_PERIOD = 0.5
"""Time between attempts to connect, s."""


class RigLink:
    """One rig on one port. A trouble is reported once as long as it lasts.

    Args:
        open_port: opens the port; called again after a loss.
        rig: the expected rig.
        on_sample: called with each reading, on the link's thread.
        on_trouble: called with one line for each trouble, on the link's thread.
        on_good: called when the rig answers (again).

    Attributes:
        client: of the present connection, greeted; None without one.
    """

    def __init__(
        self,
        open_port: Callable[[], Port],
        rig: Rig,
        on_sample: Callable[[Sample], None],
        on_trouble: Callable[[str], None],
        on_good: Callable[[], None] = lambda: None,
    ) -> None:
        self.rig = rig
        self.client: RigClient | None = None
        self._open_port = open_port
        self._on_sample = on_sample
        self._on_trouble = on_trouble
        self._on_good = on_good
        self._reported = ""
        self._last_fault = Fault.NONE
        self._jobs: queue.Queue[tuple[Callable[[RigClient], None], Future[None], int]] = (
            queue.Queue()
        )
        self._jobs_lock = threading.Lock()  # a job is queued for a connection that there is
        self._closed = threading.Event()
        self._alive_at = time.monotonic()

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
            if self.client is None:
                future.set_exception(RigLostError("there is no connection to the rig"))
            else:
                self._jobs.put((run, future, self.client.stops))
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
        while not self._closed.is_set():
            try:
                client = RigClient(self._open_port(), self.rig)
                try:
                    self._serve(client)
                    return
                finally:
                    self._drop(client)
            except RigError as error:
                if str(error) != self._reported:
                    self._reported = str(error)
                    self._on_trouble(self._reported)
            self._closed.wait(RETRY_PERIOD)

    def _drop(self, client: RigClient) -> None:
        with self._jobs_lock:
            self.client = None
            while not self._jobs.empty():
                _, future, _ = self._jobs.get_nowait()
                if future.set_running_or_notify_cancel():
                    future.set_exception(RigLostError("the connection to the rig was lost"))
        with contextlib.suppress(RigError):
            client.urgent_stop()
        client.port.close()

    def _serve(self, client: RigClient) -> None:
        client.connect()
        self.client = client
        self._reported = ""
        self._on_good()
        while not self._closed.is_set():
            client.beating = time.monotonic() - self._alive_at < OWNER_SILENCE
            for sample in client.pump():
                self._on_sample(sample)
                fault = sample.report.fault
                if fault and fault != self._last_fault:
                    self._on_trouble(
                        f"the rig switched itself off: {fault_text(fault)}; clear and arm it"
                    )
                self._last_fault = fault
            self._run_next_job(client)

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
