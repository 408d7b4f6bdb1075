"""One publisher for each tick topic: a second simulation or controller is refused before it can mix in.

The graph cannot say: a node that was killed stays in it until its lease expires, and its successor would have to wait
for that. A name in the abstract socket namespace goes with the process that holds it, however it ends, and names that
process. It reaches as far as loopback does; publishers elsewhere are recognised by what they send.
"""

from __future__ import annotations

import hashlib
import socket
import struct

from rx90_common.base.errors import ExchangeError

_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid
_PROBE_TIMEOUT = 1.0


def lock_publisher(domain: int, topic: str) -> socket.socket:
    """Lock `topic` in DDS domain `domain` for this process's publisher, for as long as the returned socket is open.

    Raises:
        ExchangeError: if another process on this machine has locked it; the text names its process id.
    """
    # Hashed, because the kernel takes 107 bytes and a namespace may be longer.
    name = "\0rx90_emulator/" + hashlib.sha256(f"{domain} {topic}".encode()).hexdigest()
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        lock.bind(name)
    except OSError:
        lock.close()
        raise ExchangeError(
            f"{topic} in ROS_DOMAIN_ID {domain} is already published by process {_holder(name)}; accepted: one "
            "publisher; end that process, or choose another ROS_DOMAIN_ID or namespace"
        ) from None
    lock.listen(1)
    return lock


def _holder(name: str) -> str:
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(_PROBE_TIMEOUT)
            probe.connect(name)
            credentials = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
            return str(_CREDENTIALS.unpack(credentials)[0])
    except OSError:
        return "(unknown)"
