"""The device's end of a line: clients come, go and do not read, and nothing waits for them."""

import os
import socket
from collections.abc import Callable

import pytest

from rx90_common.base.errors import ConfigError
from rx90_common.process.lines import DeviceLine, PseudoTerminal, TcpLine


def until(line: DeviceLine, done: Callable[[bytes], bool]) -> bytes:
    """Read until what has come is enough; the system moves it there in its own time."""
    data = b""
    while not done(data):
        line.has_new_client()
        data += line.read()
    return data


def test_one_client_after_the_other_is_heard() -> None:
    """Of two at a time the second one waits; one that breaks off loses nothing for the next."""
    line = TcpLine(0)
    address = ("127.0.0.1", int(line.name.rpartition(":")[2]))
    assert (line.has_new_client(), line.read(), line.write(b"lost")) == (False, b"", 4)
    with socket.create_connection(address) as first, socket.create_connection(address) as second:
        first.sendall(b"one")
        assert until(line, lambda data: len(data) == 3) == b"one"
        first.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # close resets the connection
        first.close()
        second.sendall(b"two")
        assert until(line, lambda data: len(data) == 3) == b"two"
        assert line.write(b"heard") == 5
        assert second.makefile("rb").read(5) == b"heard"
        with pytest.raises(ConfigError, match=rf"^port {address[1]}: .*accepted: a free one"):
            TcpLine(address[1])
    line.close()


def test_a_line_that_nobody_reads_takes_what_it_can() -> None:
    line = PseudoTerminal()
    program = os.open(line.name, os.O_RDWR | os.O_NOCTTY)
    written = 0
    while (taken := line.write(bytes(1000))) > 0:
        written += taken
    assert 0 < written < 1_000_000
    assert len(os.read(program, 100)) == 100
    line.close()
    os.close(program)
