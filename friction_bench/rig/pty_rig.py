"""The emulated rig behind a pseudo-terminal, in real time: any serial program can open it."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import time
import tty
from pathlib import Path

from friction_bench.protocol.errors import RigInputError
from friction_bench.rig.emulated import SLICE_US, EmulatedRig

_LONGEST_STEP = 0.02


class PtyRig:
    """Runs an emulated rig on a thread until `close`.

    Time that the computer does not give this program is lost to the rig too: it never runs faster than real
    time to catch up, because its host, starved as well, would seem silent to it.

    Args:
        emulated: the rig.
        link: a path that shall point to the pseudo-terminal, replaced if it is a symbolic link already.

    Attributes:
        path: what a serial program opens.
    """

    def __init__(self, emulated: EmulatedRig, link: Path | None = None) -> None:
        self.emulated = emulated
        self._master, self._slave = pty.openpty()
        # Raw before anybody opens it, and held open here: a line without an opener would echo and lose bytes.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._link = self._make_link(link) if link else None
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="emulated rig", daemon=True)
        self._thread.start()

    def _make_link(self, link: Path) -> Path:
        try:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(self.path)
        except OSError as error:
            raise RigInputError(f"{link}: cannot point to the emulated rig ({error.strerror})") from error
        return link

    def load(self, loaded: bool) -> None:
        """Couple the revolute joint, or take it off."""
        with self._lock:
            self.emulated.plant.load(loaded)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            behind = time.monotonic() - due
            if behind < SLICE_US * 1e-6:
                select.select([self._master], [], [], 2 * SLICE_US * 1e-6)
            if behind > _LONGEST_STEP:
                due += behind - _LONGEST_STEP
                behind = _LONGEST_STEP
            slices = int(behind * 1e6 / SLICE_US)
            if slices:
                due += slices * SLICE_US * 1e-6
                with self._lock:
                    self._exchange(slices * SLICE_US * 1e-6)

    def _exchange(self, seconds: float) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            self.emulated.board.write(os.read(self._master, 4096))
        self.emulated.advance(seconds)
        data = self.emulated.board.read()
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self._master, data)  # nobody reads: a full line loses bytes, as a real one does

    def close(self) -> None:
        """End the rig: for its opener, this is an unplugged cable."""
        self._stop.set()
        self._thread.join()  # as late as it may be: it must not write to what has got the descriptor's number since
        # The link first: the name that it points to may soon be another program's pseudo-terminal.
        if self._link is not None and self._link.is_symlink() and str(self._link.readlink()) == self.path:
            self._link.unlink(missing_ok=True)  # unless another rig has taken the name over
        for descriptor in (self._slave, self._master):
            with contextlib.suppress(OSError):
                os.close(descriptor)
