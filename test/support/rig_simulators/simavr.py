"""The ATmega328P binary in simavr, in this process, exact to the cycle."""

import ctypes
import subprocess
import weakref
from pathlib import Path

SHIM = Path(__file__).with_name("simavr_board.c")


def build_shim(library: Path) -> None:
    command = ["cc", "-O2", "-fPIC", "-shared", str(SHIM), "-lsimavr", "-o", str(library)]
    subprocess.run(command, check=True, capture_output=True, text=True)


def read_intel_hex(path: Path) -> bytes:
    """Return the flash image of an Intel hex file that starts at address 0."""
    image = bytearray()
    for line in path.read_text(encoding="utf-8").splitlines():
        record = bytes.fromhex(line[1:])
        if record[3] == 0:
            start = record[1] << 8 | record[2]
            image.extend(b"\xff" * (start + record[0] - len(image)))
            image[start : start + record[0]] = record[4 : 4 + record[0]]
    return bytes(image)


class SimavrBoard:
    def __init__(self, library: Path, firmware: Path) -> None:
        self._lib = ctypes.CDLL(str(library))
        self._lib.board_new.restype = ctypes.c_void_p
        for name in ("board_dac", "board_worst_dac", "board_stage", "board_register"):
            getattr(self._lib, name).restype = ctypes.c_uint8
        flash = read_intel_hex(firmware)
        self._board = ctypes.c_void_p(self._lib.board_new(flash, len(flash)))
        self._buffer = ctypes.create_string_buffer(4096)
        self._finalizer = weakref.finalize(self, self._lib.board_free, self._board)

    def reset(self) -> None:
        self._lib.board_reset(self._board)

    def write(self, data: bytes) -> None:
        self._lib.board_write(self._board, data, len(data))

    def read(self) -> bytes:
        count = self._lib.board_read(self._board, self._buffer, 4096)
        return self._buffer.raw[:count]

    def run(self, slice_us: int, edges: int, adc: int) -> None:
        self._lib.board_run(self._board, slice_us, edges, adc)

    @property
    def dac(self) -> int:
        return int(self._lib.board_dac(self._board))

    @property
    def stage_on(self) -> bool:
        return bool(self._lib.board_stage(self._board))

    def register(self, address: int) -> int:
        return int(self._lib.board_register(self._board, address))

    def sense(self, channel: int) -> None:
        self._lib.board_sense(self._board, channel)

    def close(self) -> None:
        self._finalizer()
