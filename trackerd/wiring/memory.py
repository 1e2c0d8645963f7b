"""The daemon's memory: small, and out of the collector's way.

glibc gives each thread an arena of its own, up to eight a core, and what a start-up has freed stays with the process: together
they cost a daemon of twenty threads some 30 MB (mallopt(3), malloc_trim(3)). Other C libraries have neither call, and lack
nothing.
"""

import ctypes
import gc

M_ARENA_MAX, M_MMAP_THRESHOLD = -8, -3
ARENAS = 2
OWN_PAGES = 512 * 1024  # a buffer of this size, as a search of the whole image takes many, goes back as soon as it is freed
_libc = ctypes.CDLL(None)


def begin() -> None:
    """First thing: nothing that is made before READY is garbage, and looking for it takes a fifth of the start."""
    gc.disable()
    if hasattr(_libc, "mallopt"):
        _libc.mallopt(M_ARENA_MAX, ARENAS)
        _libc.mallopt(M_MMAP_THRESHOLD, OWN_PAGES)


def settle() -> None:
    """At READY: what lives now lives for good, so the collector need not look at it again (a full pass takes 10-50 ms)."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
    gc.enable()
    if hasattr(_libc, "malloc_trim"):
        _libc.malloc_trim(0)


def release() -> None:
    """At the end, so that libraries can clear up."""
    gc.unfreeze()
