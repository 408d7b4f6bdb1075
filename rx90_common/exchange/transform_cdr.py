"""tf2_msgs/TFMessage as CDR bytes: frames and translations stay, stamp and rotations change."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, LITTLE_ENDIAN

_STAMP, _COUNT = struct.Struct("<iI"), struct.Struct("<I")
_TRANSLATION, _ROTATION = struct.Struct("<3d"), struct.Struct("<4d")


class TransformCodec:
    """Encode transforms between given frames; alignment padding is written as zeros.

    Args:
        links: names of parent and child frame.
        translation: (n, 3) m.
    """

    def __init__(self, links: Sequence[tuple[str, str]], translation: Array) -> None:
        body = bytearray(_COUNT.pack(len(links)))
        self._stamps, self._rotations = [], []
        for (parent, child), shift in zip(links, translation, strict=True):
            _align(body, 4)
            self._stamps.append(ENCAPSULATION + len(body))
            body += bytes(_STAMP.size) + _string(parent)
            _align(body, 4)
            body += _string(child)
            _align(body, 8)
            body += _TRANSLATION.pack(*shift)
            self._rotations.append(ENCAPSULATION + len(body))
            body += bytes(_ROTATION.size)
        self._message = bytearray(LITTLE_ENDIAN) + body

    def encode(self, stamp_ns: int, rotation: Array) -> bytes:
        """Return the message.

        Args:
            stamp_ns: of all transforms.
            rotation: (n, 4) quaternions, scalar last.
        """
        stamp = divmod(stamp_ns, NANOSECONDS)
        for at in self._stamps:
            _STAMP.pack_into(self._message, at, *stamp)
        for at, quaternion in zip(self._rotations, rotation.tolist(), strict=True):
            _ROTATION.pack_into(self._message, at, *quaternion)
        return bytes(self._message)


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


def _string(text: str) -> bytes:
    encoded = text.encode() + b"\0"
    return _COUNT.pack(len(encoded)) + encoded
