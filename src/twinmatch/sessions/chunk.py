"""The records in a chunk of an MCAP file, unpacked only up to the size the chunk states.

A chunk of some kilobytes may unpack to gigabytes, and the stated size may be wrong.
"""

from __future__ import annotations

import zlib

from mcap.records import Chunk

__all__ = ["MOST_UNPACKED", "ChunkError", "unpacked"]

MOST_UNPACKED = 1 << 28
"""Longest chunk, unpacked bytes: recorders write chunks of a few megabytes, or one longer message."""


class ChunkError(Exception):
    """The records of a chunk cannot be read; the message says why."""


def unpacked(chunk: Chunk) -> bytes:
    """The records in a chunk, checked against its stated size and CRC.

    Raises:
        ChunkError: it is compressed in an unknown way, unpacks to another size, or is too large.
    """
    size = chunk.uncompressed_size
    if size > MOST_UNPACKED:
        raise ChunkError(f"a chunk of {size} bytes is longer than the limit of {MOST_UNPACKED}")
    data = chunk.data
    if chunk.compression:
        try:
            data = _decompressed(chunk.compression, data, size + 1)
        except ChunkError:
            raise
        except Exception as error:  # every compressor raises its own
            raise ChunkError(
                f"a chunk compressed with {chunk.compression} cannot be unpacked ({error})"
            ) from error
    if len(data) != size or chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise ChunkError("the file is damaged: the checksum of a chunk is wrong")
    return data


def _decompressed(compression: str, data: bytes, most: int) -> bytes:
    """The first `most` unpacked bytes."""
    if compression == "zstd":
        import zstandard  # noqa: PLC0415 - rarely needed

        with zstandard.ZstdDecompressor(max_window_size=MOST_UNPACKED).stream_reader(data) as reader:
            return bytes(reader.read(most))
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]  # noqa: PLC0415

        return bytes(LZ4FrameDecompressor().decompress(data, max_length=most))
    raise ChunkError(f"a chunk is compressed with {compression[:40]!r}, which is not supported")
