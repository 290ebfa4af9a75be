"""Tuning of how the memory allocator keeps freed memory."""

import ctypes
import platform

_LARGEST_MAPPED = 31 << 20  # bytes; glibc adapts its threshold to freed blocks of up to 32 MB
_KEPT = 256 << 20  # bytes, several times the temporary memory of a shard
_ALL_KEPT = (1 << 31) - 1  # bytes, the greatest int that mallopt takes
_M_TRIM_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -4, -8  # malloc.h


def keep_freed_memory(whole: bool = False) -> None:
    """Make glibc keep up to 256 MB of freed memory; best called before a process has allocated much. No effect with other C libraries.

    Otherwise the arrays of each step are returned to the system, which clears every page of the next step's: 60,000 page faults in a small
    bake.

    whole   keep up to 2 GB, in blocks of any size, and share freed memory between threads that start later; for a process that ends with
            its bake
    Source: mallopt(3), M_MMAP_THRESHOLD: this and the trim threshold adapt to the largest mapped block that was freed, the latter until it
    is set. Larger blocks are mapped individually unless M_MMAP_MAX is 0.
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
