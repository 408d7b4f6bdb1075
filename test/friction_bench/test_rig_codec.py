"""The codec: COBS and CRC against independent definitions, fuzzing, and the firmware's decoder beside it."""

import ctypes
import random
import shutil
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from friction_bench.rig.emulated import native_library
from friction_bench.rig.messages import (
    MAX_DECODED,
    Frame,
    FrameDecoder,
    cobs_decode,
    cobs_encode,
    crc16,
    decode,
    encode,
    parse_hello,
    parse_report,
)

BYTE = st.integers(0, 255)
FRAMES = st.builds(Frame, BYTE, BYTE, st.binary(max_size=MAX_DECODED - 4))


def crc_by_division(data: bytes) -> int:
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            carry = (register >> 15) ^ (byte >> bit & 1)
            register = (register << 1 & 0xFFFF) ^ (0x1021 if carry else 0)
    return register


@given(st.binary(max_size=40))
@example(b"123456789")
def test_crc_is_the_remainder_of_the_division(data: bytes) -> None:
    """The library's CRC equals bitwise polynomial division; of "123456789" it is the published 0x29B1."""
    assert crc16(data) == (0x29B1 if data == b"123456789" else crc_by_division(data))


@pytest.mark.parametrize(
    ("plain", "coded"),
    [("", "01"), ("00", "0101"), ("0000", "010101"), ("11220033", "0311220233"), ("11000000", "0211010101")],
)
def test_cobs_gives_the_published_examples(plain: str, coded: str) -> None:
    """Cheshire and Baker's examples come out in both directions."""
    assert cobs_encode(bytes.fromhex(plain)).hex() == coded
    assert cobs_decode(bytes.fromhex(coded)) == bytes.fromhex(plain)


@settings(max_examples=500)
@given(st.lists(st.binary(max_size=60), max_size=8))
def test_no_bytes_raise_and_what_is_accepted_is_intact(chunks: list[bytes]) -> None:
    """Arbitrary bytes in any portions never raise, and each accepted frame stands whole in the stream."""
    decoder = FrameDecoder()
    stream = b"".join(chunks)
    for chunk in chunks:
        for frame in decoder.feed(chunk):
            assert encode(frame) in b"\0" + stream
            parse_report(frame)
            parse_hello(frame)


@given(FRAMES, FRAMES, st.binary(max_size=80).filter(lambda noise: 0 not in noise))
def test_noise_costs_one_frame_at_most(first: Frame, second: Frame, noise: bytes) -> None:
    """A frame holds one zero, at its end, and is understood whatever came before it."""
    assert encode(first).index(0) == len(encode(first)) - 1
    frames = FrameDecoder().feed(encode(first) + noise + b"\0" + encode(second))
    assert frames[0] == first
    assert frames[-1] == second


@settings(max_examples=300)
@given(FRAMES, st.data())
def test_one_or_two_flipped_bits_are_never_accepted(frame: Frame, data: st.DataObject) -> None:
    """Any two flipped bits that leave the COBS framing alone are caught by the CRC (Hamming distance 4)."""
    body = bytes([frame.type, frame.sequence]) + frame.payload
    sealed = bytearray(body + crc16(body).to_bytes(2, "little"))
    for at in data.draw(st.sets(st.integers(0, 8 * len(sealed) - 1), min_size=1, max_size=2)):
        sealed[at // 8] ^= 1 << at % 8
    assert decode(cobs_encode(bytes(sealed))) is None


def test_the_firmware_sends_and_accepts_what_python_does(tmp_path: Path) -> None:
    """100,000 frames are the same bytes; with 1 % of those hit, both accept the same, all of which had been sent."""
    library = ctypes.CDLL(shutil.copy(native_library({}), tmp_path))
    library.frame_receive.restype = ctypes.c_bool
    buffer = (ctypes.c_uint8 * 8).in_dll(library, "frame_rx")
    length = ctypes.c_uint8.in_dll(library, "frame_rx_length")
    message = (ctypes.c_uint8 * 19).in_dll(library, "frame_tx")
    message_length = ctypes.c_uint8.in_dll(library, "frame_tx_length")
    random_, decoder, sent, accepted = random.Random(1), FrameDecoder(), set(), 0
    for _ in range(100):
        stream = bytearray()
        for _ in range(1000):
            frame = Frame(random_.randrange(256), random_.randrange(256), random_.randbytes(random_.randrange(5)))
            sent.add(frame)
            stream += encode(frame)
            body = bytes([frame.type, frame.sequence]) + frame.payload
            message[1 : 1 + len(body)] = list(body)
            library.frame_send(len(body))
            assert bytes(message)[: message_length.value] == encode(frame)
        for _ in range(len(stream) // 100):
            at, how = random_.randrange(len(stream)), random_.randrange(3)
            if how == 0:
                stream[at] ^= 1 << random_.randrange(8)
            else:
                stream[at : at + 1] = bytes([stream[at]]) * (how - 1) * 2
        theirs = [bytes(buffer)[: length.value] for byte in stream if library.frame_receive(byte)]
        ours = [frame for frame in decoder.feed(bytes(stream)) if len(frame.payload) <= 4]
        assert theirs == [bytes([frame.type, frame.sequence]) + frame.payload for frame in ours]
        assert sent.issuperset(ours)
        accepted += len(ours)
    assert accepted > 85_000
