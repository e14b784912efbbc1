"""The records in a chunk of an MCAP file, unpacked no further than the chunk says.

A chunk of some kilobytes may unpack to gigabytes, and the size it states may be wrong.
"""

from __future__ import annotations

import zlib

from mcap.records import Chunk

__all__ = ["MOST_UNPACKED", "ChunkError", "unpacked"]

MOST_UNPACKED = 1 << 28
"""Longest chunk, bytes unpacked: recorders gather a few megabytes, or one message if it is longer."""


class ChunkError(Exception):
    """Why the records of a chunk cannot be had."""


def unpacked(chunk: Chunk) -> bytes:
    """The records in a chunk, checked against the size and the CRC it carries.

    Raises:
        ChunkError: it is compressed in an unknown way, unpacks to another size, or is too large.
    """
    size = chunk.uncompressed_size
    if size > MOST_UNPACKED:
        raise ChunkError(f"a chunk of {size} bytes is longer than the {MOST_UNPACKED} that are read")
    data = chunk.data
    if chunk.compression:
        try:
            data = _decompressed(chunk.compression, data, size + 1)
        except ChunkError:
            raise
        except Exception as error:  # each compressor has its own
            raise ChunkError(
                f"a chunk compressed with {chunk.compression} cannot be unpacked ({error})"
            ) from error
    if len(data) != size or chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise ChunkError("the file is damaged: the checksum of a chunk is wrong")
    return data


def _decompressed(compression: str, data: bytes, most: int) -> bytes:
    """The first bytes of what was compressed, at most so many."""
    if compression == "zstd":
        import zstandard  # noqa: PLC0415 - only who meets it needs it

        with zstandard.ZstdDecompressor(max_window_size=MOST_UNPACKED).stream_reader(data) as reader:
            return bytes(reader.read(most))
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]  # noqa: PLC0415

        return bytes(LZ4FrameDecompressor().decompress(data, max_length=most))
    raise ChunkError(f"a chunk is compressed with {compression[:40]!r}, which is not known")
