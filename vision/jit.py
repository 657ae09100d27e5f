"""Compiled functions: the one place where numba's untyped decorator meets typed code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The same function as machine code, compiled at its first call and kept on disk.

    It runs without the interpreter lock, so other threads go on while it works. Arguments must be
    plain numbers and contiguous arrays; the first call of a machine takes seconds (`warm_up`).
    """
    return cast("Callable[P, R]", numba.njit(nogil=True, cache=True)(function))


def compiled_sums(function: Callable[P, R]) -> Callable[P, R]:
    """As `compiled`, for long sums whose order does not matter: several terms are added at once."""
    return cast(
        "Callable[P, R]",
        numba.njit(nogil=True, cache=True, fastmath={"reassoc", "nsz", "contract"})(function),
    )


def steady(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A contiguous view or copy, closed for writing, whatever came.

    To compiled code a writable array is another type than a closed one, and a type it has not met costs
    seconds of compiling: where a slice may be a view one day and a copy the next, this makes them alike.
    """
    view = np.ascontiguousarray(array)[...]
    view.setflags(write=False)
    return view
