"""A rig behind a pseudo-terminal that bears a busy machine, and a link to it, both on threads of the test."""

import itertools
import os
import select
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from processes import TIMEOUT, wait_until

from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, NativeBoard, PtyRig, VirtualPort
from friction_bench.rig.link import RigLink
from friction_bench.rig.messages import Command, FrameDecoder, ResetCause, State
from friction_bench.rig.rig_file import Rig
from friction_bench.rig.serial_port import SerialPort
from rx90_common.base.share import config_path

PATIENCE = 0.06
"""Silence of its host, s of its own time, that an armed rig bears before its time stands still; half the watchdog's."""


def rig_file_with(folder: Path, shipped: str, changes: dict[str, str]) -> Path:
    text = config_path(shipped).read_text(encoding="utf-8")
    for old, new in changes.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / Path(shipped).name).write_text(text, encoding="utf-8")
    return folder / Path(shipped).name


def greeted(rig: Rig, seed: int = 1, loaded: bool = False, board: NativeBoard | None = None) -> RigClient:
    """Return a client that has greeted an emulated rig in virtual time; its `port.emulated` is that rig."""
    emulated = EmulatedRig(rig, seed, board)
    emulated.plant.load(loaded)
    client = RigClient(VirtualPort(emulated), rig)
    client.connect()
    return client


def spoil(board: NativeBoard, every: int, change: Callable[[bytes], bytes]) -> None:
    read, pieces = board.read, itertools.count(1)

    def spoilt() -> bytes:
        data = read()
        return change(data) if data and next(pieces) % every == 0 else data

    board.read = spoilt


def read_some(descriptor: int) -> bytes:
    """Return what comes next at this end of a pseudo-terminal: the system moves it there in its own time."""
    assert select.select([descriptor], [], [], TIMEOUT)[0], "waited in vain for bytes"
    return os.read(descriptor, 4096)


class PatientRig(PtyRig):
    """A rig with its stage on that waits for its host while `patient`: on a busy machine only that's clock goes on."""

    def __init__(self, emulated: EmulatedRig, link: Path) -> None:
        self.patient = True
        self._heard_at = 0.0
        super().__init__(emulated, link)

    def _exchange(self, seconds: float) -> None:
        rig = self.emulated
        if select.select([self.line.device], [], [], 0.0)[0]:
            self._heard_at = rig.time
        elif self.patient and rig.board.stage_on and rig.time + seconds > self._heard_at + PATIENCE:
            return
        super()._exchange(seconds)

    @contextmanager
    def standing_still(self) -> Iterator[None]:
        with self._lock:
            yield

    def hear(self, command: Command) -> None:
        decoder, heard = FrameDecoder(), False
        while not heard:
            data = read_some(self.line.device)
            self.emulated.board.write(data)
            heard = any(frame.type == command for frame in decoder.feed(data))


class Bench:
    """A rig that can be unplugged, reset and made to talk nonsense, and the link, with what it has told."""

    def __init__(self, rig: Rig, link: Path) -> None:
        self.rig = rig
        self.path = link
        self.troubles: list[str] = []
        self.samples = 0
        self.plug()
        self.link = RigLink(lambda: SerialPort(str(link), rig.baud), rig, self._count, self.troubles.append)
        self._dead = threading.Event()
        self._threads = [threading.Thread(target=self.link.run), threading.Thread(target=self._live)]
        for thread in self._threads:
            thread.start()
        wait_until(lambda: self.link.connected and self.link.last is not None, "a connection")

    def _count(self, _: object) -> None:
        self.samples += 1

    def _live(self) -> None:
        while not self._dead.wait(0.01):
            self.link.alive()

    def plug(self) -> None:
        self.pty = PatientRig(EmulatedRig(self.rig, 1), self.path)

    @property
    def board(self) -> NativeBoard:
        board = self.pty.emulated.board
        assert isinstance(board, NativeBoard)
        return board

    @property
    def state(self) -> State | None:
        report = self.link.last
        return None if report is None else report.state

    def reset(self) -> None:
        with self.pty.standing_still():
            self.board.reset(ResetCause.WATCHDOG)

    def say(self, data: bytes) -> None:
        """Put bytes on the line from the rig's side; of two writers at the same time one would be turned away."""
        with self.pty.standing_still():
            self.pty.line.write(data)

    def listen(self, count: int) -> None:
        heard = self.samples
        wait_until(lambda: self.samples >= heard + count, f"{count} readings")

    def arm(self) -> None:
        self.link.submit(RigClient.arm).result(TIMEOUT)
        wait_until(lambda: self.state == State.ARMED, "an armed rig")

    def abandon(self) -> None:
        """Stop saying that the link's owner is alive; the rig takes it for what it is."""
        self.pty.patient = False
        self._dead.set()

    def close(self) -> None:
        self.link.close()
        self.abandon()
        for thread in self._threads:
            thread.join()
        self.pty.close()
