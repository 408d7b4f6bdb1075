"""Processes of the tests without their slow imports: forked from a process that has done these once.

To a test such a process is any other one: a child of its own, with its own session, environment, working folder,
signals and streams, that ends as Python ends. It is not quite a user's: what MODULES import and the kernels of the
nodes are there before the first line runs, and options of Python itself, or what Python reads from the environment
when it starts, do nothing.

What hangs on that is proved where commands start cold, as a user's do: test_packaging.py, cli/test_nodes.py,
sweep/test_execution.py, test_record.py. A test of an import, of the first second or of Python's start belongs there.
"""

import contextlib
import ctypes
import gc
import importlib
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

MODULES = (
    *("rx90_common.bags.writing", "rx90_common.exchange.cdr", "rx90_emulator.cli.bag", "rx90_emulator.cli.line"),
    *("rx90_emulator.cli.node", "rx90_emulator.loop.closed_loop", "rx90_emulator.loop.setup"),
    *("builtin_interfaces.msg", "diagnostic_msgs.msg", "geometry_msgs.msg", "lifecycle_msgs.srv", "rcl_interfaces.srv"),
    *("rosgraph_msgs.msg", "rosidl_generator_py", "sensor_msgs.msg", "std_msgs.msg", "std_srvs.srv"),
    *("trajectory_msgs.msg", "type_description_interfaces.srv"),
)
"""What the processes of the tests import most. Not rclpy: it starts threads, and a fork would leave them behind."""
_BUILT = (
    *("action_msgs.srv", "control_msgs.action", "control_msgs.msg", "control_msgs.srv"),
    *("controller_manager_msgs.msg", "controller_manager_msgs.srv"),
)
"""So are these, where they are there."""
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_LONGEST = 1 << 20


class WarmPopen(subprocess.Popen[Any]):
    """Stands for subprocess.Popen; commands of this Python are forked, all others are started as ever."""

    def __init__(self, args: Any, *positional: Any, **options: Any) -> None:
        self._own_session = bool(options.get("start_new_session"))
        super().__init__(args, *positional, **options)

    # subprocess offers no other place in which a process is made; these arguments are the same from Python 3.10 on.
    def _execute_child(
        self, args: Any, executable: Any, preexec_fn: Any, close_fds: Any, pass_fds: Any, cwd: Any, env: Any,
        startupinfo: Any, creationflags: Any, shell: Any,
        p2cread: int, p2cwrite: int, c2pread: int, c2pwrite: int, errread: int, errwrite: int, *others: Any,
    ) -> None:  # fmt: skip
        pipes = (p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite)
        words = [] if isinstance(args, str) else [os.fspath(word) for word in args]
        if words[:1] != [sys.executable] or preexec_fn or pass_fds or shell:
            super()._execute_child(  # type: ignore[misc]
                args, executable, preexec_fn, close_fds, pass_fds, cwd, env, startupinfo, creationflags, shell,
                *pipes, *others,
            )  # fmt: skip
            return
        request = {
            "parent": os.getpid(),
            "words": [word for word in words[1:] if word != "-u"],
            "folder": os.fspath(cwd or Path.cwd()),
            "environment": dict(os.environ if env is None else env),
            "own_session": self._own_session,
        }
        streams = [own if given == -1 else given for own, given in enumerate((p2cread, c2pwrite, errwrite))]
        self.pid = _server().fork(request, streams)
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]


class _Server:
    def __init__(self) -> None:
        self._connection, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-u", __file__, str(theirs.fileno()), *MODULES]
        # It ends when the connection does: with the process of the tests, however that ends. So do those it has forked.
        self._process = COLD(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, start_new_session=True)
        theirs.close()
        self._lock = threading.Lock()

    def fork(self, request: dict[str, Any], streams: Sequence[int]) -> int:
        with self._lock:
            _adopt(True)
            try:
                socket.send_fds(self._connection, [json.dumps(request).encode()], list(streams))
                return int(self._connection.recv(_LONGEST))
            finally:
                _adopt(False)


COLD = subprocess.Popen  # for a test to which the slow imports matter
_servers: list[_Server] = []


def _server() -> _Server:
    if not _servers:
        _servers.append(_Server())
    return _servers[0]


def _adopt(on: bool) -> None:
    """Have a grandchild whose parent ends become a child of this process, or leave that to the system."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, int(on), 0, 0, 0)


def _end_with(parent: int, first: int) -> None:
    """Have this process interrupted when its parent ends, be it killed: once the first, which forked it, is gone."""
    while os.getppid() == first:
        time.sleep(1e-4)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGINT), 0, 0, 0)
    if os.getppid() != parent:
        sys.exit(0)


def _serve(connection: socket.socket) -> tuple[dict[str, Any], list[int]]:
    """Fork for each request; return in the new process alone, with the request and its streams."""
    while True:
        message, streams, _, _ = socket.recv_fds(connection, _LONGEST, 3)
        if not message:
            sys.exit(0)
        reader, writer = os.pipe()
        between = os.fork()
        if between == 0:
            first = os.getpid()
            pid = os.fork()
            if pid == 0:
                for descriptor in (reader, writer, connection.detach()):
                    os.close(descriptor)
                request = json.loads(message)
                _end_with(request["parent"], first)
                return request, streams
            os.write(writer, str(pid).encode())
            os._exit(0)  # so that its child gets another parent
        os.waitpid(between, 0)
        connection.send(os.read(reader, 32))
        for descriptor in (reader, writer, *streams):
            os.close(descriptor)


def _load_kernels() -> None:
    """Compile, or load, what nodes tick with; on new sources once here, and not in each of the first nodes."""
    from rx90_emulator.loop.setup import Setup

    setup = Setup.load()
    setup.plant().warm_up()
    setup.cs7b().warm_up()


def _become(request: dict[str, Any], streams: Sequence[int]) -> None:
    if request["own_session"]:
        os.setsid()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    for stream in streams:
        os.close(stream)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.path[1:1] = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))


def _run(words: list[str]) -> None:
    if words[0] == "-m":
        sys.argv = words[1:]
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    elif words[0] == "-c":
        sys.argv = ["-c", *words[2:]]
        main = sys.modules["__main__"] = ModuleType("__main__")
        exec(compile(words[1], "<string>", "exec"), main.__dict__)
    else:
        sys.argv = words
        sys.path[0] = str(Path(words[0]).parent)
        runpy.run_path(words[0], run_name="__main__")


if __name__ == "__main__":
    sys.path[0] = ""
    for name in sys.argv[2:]:
        importlib.import_module(name)
    if MODULES[0] in sys.modules:
        for name in _BUILT:
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
        _load_kernels()
    assert len(list(Path("/proc/self/task").iterdir())) == 1, "a thread would be missing in each fork"
    gc.freeze()  # or the first collection in each process would copy all that the imports have made
    _become(*(asked := _serve(socket.socket(fileno=int(sys.argv[1])))))
    _run(asked[0]["words"])
