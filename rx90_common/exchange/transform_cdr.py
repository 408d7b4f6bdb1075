"""tf2_msgs/TFMessage as CDR bytes: frames and translations stay, stamp and rotations change."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION
from rx90_common.exchange.cdr_body import CdrBody

_STAMP = struct.Struct("<iI")
_TRANSLATION, _ROTATION = struct.Struct("<3d"), struct.Struct("<4d")


class TransformCodec:
    """Encode transforms between given frames; alignment padding is written as zeros.

    Args:
        links: names of parent and child frame.
        translation: (n, 3) m.
    """

    def __init__(self, links: Sequence[tuple[str, str]], translation: Array) -> None:
        body = CdrBody()
        body.count(len(links))
        self._stamps, self._rotations = [], []
        for (parent, child), shift in zip(links, translation, strict=True):
            body.align(4)
            self._stamps.append(ENCAPSULATION + body.zeros(_STAMP.size))
            body.string(parent)
            body.string(child)
            body.align(8)
            body.raw += _TRANSLATION.pack(*shift)
            self._rotations.append(ENCAPSULATION + body.zeros(_ROTATION.size))
        self._message = body.message()

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
