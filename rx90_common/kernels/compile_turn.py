"""Of processes that need a kernel at once, one compiles it: the others wait for its code."""

from __future__ import annotations

import fcntl
import os
import time
from contextlib import suppress
from pathlib import Path

from rx90_common.kernels import announcement

_LONGEST_S = 120.0  # until a process compiles itself what another one never finishes
_LOOK_S = 0.02


class CompileTurn:
    """The turn to compile one kernel, held by at most one process. It ends with the process, however that ends.

    Args:
        file: of the lock, there while a process compiles.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._descriptor: int | None = None

    def take(self) -> None:
        """Wait until no other process compiles this kernel; without delay where no lock can be made."""
        if self._descriptor is not None:  # the kernel is compiled again, for arguments that are literals
            return
        try:
            descriptor = os.open(self._file, os.O_CREAT | os.O_RDWR, 0o666)
        except OSError:
            return
        try:
            self._wait(descriptor)
        except BaseException:  # Ctrl-C
            os.close(descriptor)
            raise
        self._descriptor = descriptor

    def _wait(self, descriptor: int) -> None:
        end = time.monotonic() + _LONGEST_S
        while time.monotonic() < end:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                announcement.compilation_begins()
                time.sleep(_LOOK_S)
            except OSError:  # a file system without locks
                return
            else:
                return

    def release(self) -> None:
        """Let others have it; who waits looks for the code first."""
        if self._descriptor is None:
            return
        with suppress(OSError):
            self._file.unlink()
        os.close(self._descriptor)
        self._descriptor = None
