"""Digests of bytes, files and the core's own code."""

import hashlib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

_DIGEST_BYTES = 20


def hash_pieces(pieces: Iterable[bytes | memoryview]) -> str:
    """Digest of the pieces and their lengths, in order."""
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for piece in pieces:
        digest.update(memoryview(piece).nbytes.to_bytes(8, "little"))
        digest.update(piece)
    return digest.hexdigest()


def hash_file(path: Path) -> str:
    """Digest of a file's bytes.

    Raises OSError if it cannot be read.
    """
    with open(path, "rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=_DIGEST_BYTES)).hexdigest()


@lru_cache(maxsize=1)
def hash_code() -> str:
    """Digest of the core's own source files, since another version may bake to other bytes."""
    folder = Path(__file__).parent.parent
    sources = sorted(folder.rglob("*.py"))
    return hash_pieces(piece for path in sources for piece in (path.relative_to(folder).as_posix().encode(), path.read_bytes()))
