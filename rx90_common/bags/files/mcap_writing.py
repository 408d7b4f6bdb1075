"""Write mcap files with the checksums that rosbags leaves out."""

from __future__ import annotations

import struct
from zlib import crc32

from rosbags.rosbag2.storage_mcap import McapWriter

from rx90_common.bags.files.mcap_records import HEAD_BYTES, MAGIC

_CRC_IN_CHUNK = 24  # behind two times and a size
_FOOTER = struct.Struct("<QQI")
_CRC = struct.Struct("<I")


class ChecksummedMcapWriter(McapWriter):
    """Gives each chunk and the summary its checksum, so that a reader knows of each bit that has changed."""

    def close_chunk(self) -> None:
        """Write the chunk; its checksum comes after it, and until then says that there is none."""
        with self.chunk.bio.getbuffer() as content:
            crc = crc32(content)
        start = self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + HEAD_BYTES + _CRC_IN_CHUNK)
        self.bio.write(_CRC.pack(crc))
        self.bio.seek(end)

    def close(self, version: int, metadata: str) -> None:
        """Write the summary and close the file."""
        super().close(version, metadata)
        with self.path.open("r+b") as stream:
            stream.seek(-_FOOTER.size - len(MAGIC), 2)
            summary, _, _ = _FOOTER.unpack(stream.read(_FOOTER.size))
            stream.seek(summary)
            crc = crc32(stream.read()[: -_CRC.size - len(MAGIC)])
            stream.seek(-_CRC.size - len(MAGIC), 2)
            stream.write(_CRC.pack(crc))
