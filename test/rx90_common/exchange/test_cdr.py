"""The JointState codec against the serialisers of rclpy and rosbags."""

import gc
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.cdr import JointStateCodec

MOTORS = tuple(f"motor_{i}" for i in range(1, 7))
STORE = get_typestore(Stores.ROS2_JAZZY)
NS = 10**9

names_of_joints = st.lists(
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=9),
    min_size=1,
    max_size=7,
    unique=True,
)
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
stamps = st.integers(0, (1 << 31) * NS - 1)
numbers = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def messages(draw):
    names = draw(names_of_joints)
    array = st.none() | st.lists(numbers, min_size=len(names), max_size=len(names)).map(np.array)
    return names, draw(frames), draw(stamps), [draw(array) for _ in range(3)]


def rosbags_bytes(names, frame_id, stamp_ns, arrays, *, little_endian=True):
    types = STORE.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=stamp_ns // NS, nanosec=stamp_ns % NS), frame_id=frame_id
    )
    filled = [np.array([]) if a is None else np.asarray(a, float) for a in arrays]
    message = types["sensor_msgs/msg/JointState"](header, list(names), *filled)
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=little_endian))


def assert_same(decoded, stamp_ns, arrays):
    assert decoded[0] == stamp_ns
    for got, expected in zip(decoded[1:], arrays, strict=True):
        if expected is None:
            assert got is None
        else:
            assert got.dtype == np.float64
            assert got.flags.aligned
            assert got.tobytes() == np.asarray(expected, float).tobytes()


@settings(max_examples=60)
@given(messages())
def test_encoding_equals_the_one_of_rosbags(message):
    """Every message is byte for byte what an independent CDR serialiser with zero padding writes."""
    names, _, stamp_ns, arrays = message
    raw = JointStateCodec(names).encode(stamp_ns, *arrays)
    assert raw == rosbags_bytes(names, "", stamp_ns, arrays)
    two = [None if values is None else np.stack([values, values[::-1]]) for values in arrays]
    rows = JointStateCodec(names).encode_many(np.array([stamp_ns, 0]), *two)
    second = [None if values is None else values[1] for values in two]
    assert rows[0].tobytes() == raw
    assert rows[1].tobytes() == rosbags_bytes(names, "", 0, second)


@given(messages(), messages(), st.randoms(use_true_random=False), st.booleans())
def test_decoding_reads_every_layout(message, other, random, little_endian):
    """Any order of names, frame_id, byte order and set of arrays gives the numbers that were sent."""
    names, frame_id, stamp_ns, arrays = message
    codec = JointStateCodec(names)
    order = list(range(len(names)))
    random.shuffle(order)
    shuffled = [None if a is None else a[order] for a in arrays]
    raw = rosbags_bytes([names[i] for i in order], frame_id, stamp_ns, shuffled, little_endian=little_endian)
    for _ in range(2):  # the second time with the other layout expected
        assert_same(codec.decode(raw), stamp_ns, arrays)
        assert_same(codec.decode(codec.encode(other[2], *arrays)), other[2], arrays)


@settings(max_examples=120)
@given(st.integers(0, 259), st.binary(min_size=1, max_size=8), st.integers(0, 300))
def test_damaged_bytes_never_pass_silently_or_crash(at, damage, length):
    """Damaged or cut bytes give either an ExchangeError of one line or finite arrays of the right shape."""
    codec = JointStateCodec(MOTORS)
    raw = bytearray(codec.encode(5, *np.arange(18.0).reshape(3, 6)))
    raw[at : at + len(damage)] = damage
    complaint, decoded = "", (0,)
    try:
        decoded = codec.decode(bytes(raw[:length]))
    except ExchangeError as error:
        complaint = str(error)
    assert len(complaint.splitlines()) == (1 if decoded == (0,) else 0)
    assert all(a is None or (a.shape == (6,) and np.isfinite(a).all()) for a in decoded[1:])


def encoded(names=MOTORS, arrays=None):
    return rosbags_bytes(names, "", 0, (None, None, np.ones(6)) if arrays is None else arrays)


FULL = JointStateCodec(MOTORS).encode(0, effort=np.ones(6))


@pytest.mark.parametrize(
    ("raw", "complaint"),
    [
        (b"\0\1\0\0", "cut off in header.stamp"),
        (FULL[:-9], "cut off in effort"),
        (FULL + bytes(16), "16 bytes behind its end"),
        (b"\0\7\0\0" + FULL[4:], "encapsulation 0x0007"),
        (encoded(names=(*MOTORS[:5], "motor_7")), "'motor_7' is unknown; accepted: motor_1, motor_2"),
        (encoded(names=(*MOTORS[:5], "motor_1")), "'motor_1' is repeated"),
        (encoded(arrays=(None, None, np.ones(7))), "effort has 7 elements; accepted: 6 or none"),
        (encoded(arrays=(None, np.array([0, 0, np.nan, 0, 0, 0]), None)), "velocity of motor_3 is nan"),
        (FULL[:8] + struct.pack("<I", NS) + FULL[12:], "nanosec is 1000000000"),
    ],
)
def test_bad_messages_are_refused_by_name(raw, complaint):
    """Each kind of bad message is refused with the offending value, whichever layout was expected."""
    codec = JointStateCodec(MOTORS)
    for expected in (FULL, encoded(arrays=np.ones((3, 6)))):
        codec.decode(expected)
        with pytest.raises(ExchangeError) as caught:
            codec.decode(raw)
        assert complaint in str(caught.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_fast_path_refuses_numbers_that_are_not_finite(bad):
    """A NaN or infinity at any place of the expected layout is refused, and huge finite numbers are not."""
    codec = JointStateCodec(MOTORS)
    for index in range(18):
        values = np.full(18, 1.7e308)
        assert codec.decode(codec.encode(0, *values.reshape(3, 6)))[1] is not None
        values[index] = bad
        with pytest.raises(ExchangeError, match=f"of motor_{index % 6 + 1} is {bad}"):
            codec.decode(codec.encode(0, *values.reshape(3, 6)))


@pytest.mark.parametrize(
    ("stamp_ns", "array", "complaint"),
    [(-1, np.ones(6), "-1 ns"), (0, np.ones(5), r"shape \(5,\)"), (0, np.ones(6, dtype=np.int64), "int64")],
)
def test_encoding_refuses_what_the_message_cannot_hold(stamp_ns, array, complaint):
    """A stamp out of range, an array of another shape or type, and names that are not given once each are refused."""
    with pytest.raises(ExchangeError, match=complaint):
        JointStateCodec(MOTORS).encode(stamp_ns, effort=array)
    for names in ((), ("",), ("a", "a"), ("a\0b",)):
        with pytest.raises(ExchangeError):
            JointStateCodec(names)


def test_an_encoder_outlives_its_codec_and_its_arrays() -> None:
    """An encoder reads its arrays when it is called; neither the codec nor the arrays need another owner."""
    now = np.zeros(6)
    encode_now = JointStateCodec(MOTORS).encoder(effort=now)
    now[:] = 3.0
    assert JointStateCodec(MOTORS).decode(encode_now(0))[3].tolist() == [3.0] * 6
    encoders = [JointStateCodec(MOTORS).encoder(effort=np.full(6, float(n))) for n in range(50)]
    gc.collect()
    rubbish = [np.full(6, -1.0) for _ in range(1000)] + [np.full(5, -1) for _ in range(1000)]
    reader = JointStateCodec(MOTORS)
    for n, encode in enumerate(encoders):
        stamp, _, _, effort = reader.decode(encode(n))
        assert (stamp, effort.tolist()) == (n, [float(n)] * 6)
    assert len(rubbish) == 2000
