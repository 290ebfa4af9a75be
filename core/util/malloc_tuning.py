"""Tuning of how the memory allocator keeps freed memory."""

from __future__ import annotations

import ctypes
import platform

_LARGEST_MAPPED = 31 << 20  # bytes: glibc follows blocks of up to 32 MB
_KEPT = 256 << 20  # bytes: what a shard takes for a while, several times over
_ALL_KEPT = (1 << 31) - 1  # bytes: mallopt takes an int
_M_TRIM_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -4, -8  # malloc.h


def keep_freed_memory(whole: bool = False) -> None:
    """Has glibc keep up to 256 MB that is freed, best before a process has allocated much; elsewhere nothing changes.

    Else the arrays of each step go back to the system, which clears every page of those of the next: 60,000 page faults in a small bake.

    whole   up to 2 GB, blocks of any size, and what one thread frees for all that are started later: for a process that ends with its bake
    Source: mallopt(3), M_MMAP_THRESHOLD: both it and the trim threshold follow the largest mapped block that was freed, the latter until
    it is set; larger blocks are mapped, each by itself, unless M_MMAP_MAX is 0.
    """
    if platform.libc_ver()[0] != "glibc":
        return
    libc = ctypes.CDLL(None)
    if whole:
        libc.mallopt(_M_MMAP_MAX, 0)
        libc.mallopt(_M_ARENA_MAX, 1)
    else:
        libc.malloc.restype, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
        libc.free(libc.malloc(ctypes.c_size_t(_LARGEST_MAPPED)))
    libc.mallopt(_M_TRIM_THRESHOLD, _ALL_KEPT if whole else _KEPT)
