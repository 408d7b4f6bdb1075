"""The device's end of a serial line: what an emulated device reads and writes, while programs open the other end."""

from __future__ import annotations

import os
import socket
import tty
from contextlib import suppress
from typing import Protocol

from rx90_common.base.errors import ConfigError

_MOST_BYTES = 4096


class DeviceLine(Protocol):
    """A line; nothing waits.

    Attributes:
        name: what programs open.
    """

    name: str

    def has_new_client(self) -> bool:
        """Return whether a program has come to the other end since the last call."""

    def read(self, most: int = _MOST_BYTES) -> bytes:
        """Return bytes that have arrived, at most so many."""

    def write(self, data: bytes | bytearray) -> int:
        """Send bytes; return how many the line took, all of them if nobody is there."""

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
        self._is_new = True

    def has_new_client(self) -> bool:
        """Return True the first time: who opens it later is not to be seen."""
        is_new = self._is_new
        self._is_new = False
        return is_new

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

    Raises:
        ConfigError: for a port that another program has.
    """

    def __init__(self, port: int) -> None:
        try:
            self._server = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            raise ConfigError(
                f"port {port}: {error.strerror}; accepted: a free one, or 0 for any"
            ) from error
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        self.name = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def has_new_client(self) -> bool:
        """Return whether a client has come; the next one comes when that has gone."""
        if self._client is not None:
            return False
        with suppress(BlockingIOError):
            self._client, _ = self._server.accept()
            self._client.setblocking(False)
        return self._client is not None

    def read(self, most: int = _MOST_BYTES) -> bytes:
        """Return bytes of the client that have arrived, at most so many."""
        if self._client is None:
            return b""
        try:
            data = self._client.recv(most)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
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
