"""The device's end of a serial line: what an emulated device reads and writes, while programs open the other end."""

from __future__ import annotations

import os
import socket
import tty
from contextlib import suppress
from typing import Protocol

_MOST_BYTES = 4096


class DeviceLine(Protocol):
    """A line; nothing waits, and a line that is full or has nobody at its other end loses what is written.

    Attributes:
        name: what programs open.
    """

    name: str

    def read(self, most: int = _MOST_BYTES) -> bytes:
        """Return bytes that have arrived, at most so many, one at least."""

    def write(self, data: bytes | bytearray) -> int:
        """Send bytes; return how many the line took."""

    def close(self) -> None:
        """Close it: for whoever has opened it, this is an unplugged cable."""


class PseudoTerminal(DeviceLine):
    """A pseudo-terminal.

    Attributes:
        device: file descriptor of the device's end.
    """

    def __init__(self) -> None:
        self.device, self._program = os.openpty()
        # Raw before anybody opens it, and held open here: a line without an opener would echo and lose bytes.
        tty.setraw(self._program)
        os.set_blocking(self.device, False)
        self.name = os.ttyname(self._program)

    def read(self, most: int = _MOST_BYTES) -> bytes:
        """Return bytes that have arrived, at most so many."""
        with suppress(OSError):
            return os.read(self.device, most)
        return b""

    def write(self, data: bytes | bytearray) -> int:
        """Send bytes; return how many the line took."""
        with suppress(OSError):
            return os.write(self.device, data)
        return 0

    def close(self) -> None:
        """Close both ends."""
        for descriptor in (self._program, self.device):
            with suppress(OSError):
                os.close(descriptor)


class TcpLine(DeviceLine):
    """A TCP port of this machine, for one client after the other.

    Args:
        port: its number; 0 for any free one.
        greeting: what each client gets first.
    """

    def __init__(self, port: int, greeting: bytes) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._server.setblocking(False)
        self._greeting = greeting
        self._client: socket.socket | None = None
        self.name = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def read(self, most: int = _MOST_BYTES) -> bytes:
        """Return bytes of the client that have arrived, at most so many; let the next one come if it has gone."""
        try:
            if self._client is None:
                self._client, _ = self._server.accept()
                self._client.setblocking(False)
                self._client.send(self._greeting)
            data = self._client.recv(most)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data and self._client is not None:
            self._client.close()
            self._client = None
        return data

    def write(self, data: bytes | bytearray) -> int:
        """Send bytes; return how many the line took, all of them if there is no client."""
        if self._client is None:
            return len(data)
        with suppress(OSError):
            return self._client.send(data)
        return 0

    def close(self) -> None:
        """Close the port and its client."""
        self._server.close()
        if self._client is not None:
            self._client.close()
