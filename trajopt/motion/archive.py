"""Arrays from an untrusted ``.npz`` archive: sizes are checked before anything is decompressed."""

import io
import math
import struct
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from trajopt.errors import SolutionFileError, first_line

# Decompressed size allowed for any archive, bytes; larger ones may have at most this ratio to the archive.
# Motions have ratios of 1 to 10, or below 100 if a robot stands still for minutes.
FREE_SIZE, MOST_RATIO = 2**28, 100
# More dimensions than any known array has.
MOST_DIMENSIONS = 4
COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# First bytes of an archive, and the file ending that NumPy gives its members.
ARCHIVE, ENDING = b"PK\x03\x04", ".npy"
# Names of number kinds in messages.
_WORDS = {"U": "text", "fiu": "float", "f": "float", "iu": "int", "b": "bool"}
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
# Exceptions that readers raise for damaged bytes, besides those of archives.
_DAMAGED = (
    *(zipfile.BadZipFile, zlib.error, EOFError, KeyError, struct.error, SyntaxError, tokenize.TokenError),
    *(ValueError, TypeError, OverflowError, NotImplementedError, RuntimeError, MemoryError, OSError),
)


def read_members(content: bytes, source: Any, known: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Return the known arrays of an archive.

    Members with other names are not read. Memory is allocated for what a member holds, not for what its
    header claims; in total at most `FREE_SIZE`, or `MOST_RATIO` times the size of the archive.

    Args:
        content: Content of the file.
        source: Name of the file, for messages.
        known: Names of arrays, each with its allowed number kinds, see `numpy.dtype.kind`.

    Raises:
        SolutionFileError: If the archive or a known member is damaged; one line.
    """
    if not content.startswith(ARCHIVE):
        raise SolutionFileError(f"{source} is not a trajopt-solution file", "an .npz archive")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = _members(archive, len(content), source, known)
            return {name: _array(archive, members[name], source, known[name]) for name in members}
    except SolutionFileError:
        raise
    except _DAMAGED as error:
        said = isinstance(error, zipfile.BadZipFile | zlib.error | EOFError)
        reason = "" if said else f": {first_line(error):.200}"
        raise SolutionFileError(f"{source} is truncated or damaged{reason}") from None


def _members(
    archive: zipfile.ZipFile, size: int, source: Any, known: Mapping[str, str]
) -> dict[str, zipfile.ZipInfo]:
    """Return the known members by name, after checking their sizes. Raises `SolutionFileError`."""
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = info.filename.removesuffix(ENDING)
        if name not in known or name == info.filename:
            continue
        if name in members:
            raise SolutionFileError(f"{source}: '{name}' is there twice", "allowed: once")
        if info.compress_type not in COMPRESSIONS or info.flag_bits & 1:
            raise SolutionFileError(
                f"{source}: '{name}' is encrypted, or compressed in an unknown way", "deflated"
            )
        members[name] = info
    packed, unpacked = (
        sum(getattr(info, part) for info in members.values()) for part in ("compress_size", "file_size")
    )
    if packed > size:
        raise SolutionFileError(f"{source} is truncated or damaged")
    if unpacked > max(FREE_SIZE, MOST_RATIO * size):
        raise SolutionFileError(
            f"{source} holds {unpacked / 1e6:.0f} MB in {size / 1e6:.1f} MB",
            f"allowed: {FREE_SIZE / 1e6:.0f} MB, or {MOST_RATIO} times the file",
        )
    return members


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo, source: Any, kinds: str) -> np.ndarray:
    """Return the array of a member; its header must state the member's exact size."""
    name = info.filename.removesuffix(ENDING)
    with archive.open(info) as member:
        content = member.read(info.file_size)  # without a size, one call could decompress without limit
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    if version not in _HEADERS:
        raise SolutionFileError(
            f"{source}: '{name}' is an array of version {version}", "allowed: (1, 0), (2, 0)"
        )
    shape, by_columns, dtype = _HEADERS[version](file)
    if dtype.kind not in kinds or dtype.subdtype is not None or not dtype.itemsize:
        raise SolutionFileError(f"{source}: '{name}' is of type {dtype!s:.60}", _WORDS[kinds])
    if len(shape) > MOST_DIMENSIONS or min(shape, default=0) < 0:
        raise SolutionFileError(
            f"{source}: '{name}' has shape {shape!s:.60}", f"up to {MOST_DIMENSIONS} dimensions"
        )
    start, count = file.tell(), math.prod(shape)
    if count * dtype.itemsize != len(content) - start:
        raise SolutionFileError(
            f"{source}: '{name}' holds {len(content) - start} bytes for shape {shape!s:.60}"
        )
    values = np.frombuffer(content, dtype=dtype, count=count, offset=start) if count else np.zeros(0, dtype)
    if (
        dtype.kind == "U"
        and values.astype(dtype.newbyteorder("=")).view(np.uint32).max(initial=0) > sys.maxunicode
    ):
        raise SolutionFileError(f"{source}: '{name}' is not a text")
    return values.reshape(shape, order="F" if by_columns else "C")
