"""Memory of a process that looks again and again."""

from __future__ import annotations

import ctypes

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""malloc.h of the GNU C library."""
KEPT_BYTES = 512 * 1024 * 1024
LARGE_BYTES = 256 * 1024 * 1024


def keep_freed() -> bool:
    """Keep what one look gives back for the next one; False where the C library knows no such setting.

    By default the GNU C library gives large pieces back to the system at once, and every look pages them
    in anew: thousands of page faults, a tenth of its time. Up to `KEPT_BYTES` stay with the process now.
    """
    library = ctypes.CDLL(None)
    if not hasattr(library, "mallopt"):
        return False
    return bool(library.mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)) and bool(
        library.mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)
    )
