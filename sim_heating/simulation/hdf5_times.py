"""netCDF files without the time at which they were made, so that equal results are equal files.

The library of HDF5 writes times of access, modification, change and birth into the header of the root group, and netCDF
has no option against it. They are set to 0 here and the checksum of the header, Jenkins' lookup3, is made again.

Source: The HDF Group, HDF5 File Format Specification 3.0, sections II.A (superblock) and IV.A.1.b (object header of
version 2); B. Jenkins, lookup3.c (2006), hashlittle.
"""

from __future__ import annotations

import struct

SUPERBLOCK, HEADER = b"\x89HDF\r\n\x1a\n", b"OHDR"
HAS_TIMES, HAS_PHASES = 0x20, 0x10
"""Flags of an object header: times are stored; limits of the storage of attributes are."""
ROOT = 36
"""Offset of the address of the root group in a superblock of version 2 or 3."""
MASK = 0xFFFFFFFF


def without_times(data: bytes) -> bytes:
    """A netCDF-4 file with times of 0 in the header of its root group; a file of another layout as it is."""
    if data[:8] != SUPERBLOCK or data[8] not in (2, 3):
        return data
    (start,) = struct.unpack_from("<Q", data, ROOT)
    flags = data[start + 5]
    if data[start : start + 4] != HEADER or not flags & HAS_TIMES:
        return data
    size_at = start + 22 + (4 if flags & HAS_PHASES else 0)
    width = 1 << (flags & 3)
    end = size_at + width + int.from_bytes(data[size_at : size_at + width], "little")
    if struct.unpack_from("<I", data, end)[0] != lookup3(data[start:end]):
        return data
    header = data[start : start + 6] + bytes(16) + data[start + 22 : end]
    return data[:start] + header + struct.pack("<I", lookup3(header)) + data[end + 4 :]


def lookup3(key: bytes) -> int:
    """Jenkins' hash of bytes, 32 bits, with an initial value of 0.

    >>> from sim_heating.simulation.hdf5_times import lookup3
    >>> hex(lookup3(b"Four score and seven years ago"))
    '0x17770551'
    """
    a = b = c = (0xDEADBEEF + len(key)) & MASK
    while len(key) > 12:
        x, y, z = struct.unpack_from("<3I", key)
        a, b, c = (a + x) & MASK, (b + y) & MASK, (c + z) & MASK
        a = (a - c) & MASK ^ _rotated(c, 4)
        c = (c + b) & MASK
        b = (b - a) & MASK ^ _rotated(a, 6)
        a = (a + c) & MASK
        c = (c - b) & MASK ^ _rotated(b, 8)
        b = (b + a) & MASK
        a = (a - c) & MASK ^ _rotated(c, 16)
        c = (c + b) & MASK
        b = (b - a) & MASK ^ _rotated(a, 19)
        a = (a + c) & MASK
        c = (c - b) & MASK ^ _rotated(b, 4)
        b = (b + a) & MASK
        key = key[12:]
    if not key:
        return c
    x, y, z = struct.unpack("<3I", key.ljust(12, b"\0"))
    a, b, c = (a + x) & MASK, (b + y) & MASK, (c + z) & MASK
    c = ((c ^ b) - _rotated(b, 14)) & MASK
    a = ((a ^ c) - _rotated(c, 11)) & MASK
    b = ((b ^ a) - _rotated(a, 25)) & MASK
    c = ((c ^ b) - _rotated(b, 16)) & MASK
    a = ((a ^ c) - _rotated(c, 4)) & MASK
    b = ((b ^ a) - _rotated(a, 14)) & MASK
    return ((c ^ b) - _rotated(b, 24)) & MASK


def _rotated(x: int, bits: int) -> int:
    return (x << bits | x >> (32 - bits)) & MASK
