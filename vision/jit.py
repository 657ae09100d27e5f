"""Compiled functions: the one place where numba's untyped decorator meets typed code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

P = ParamSpec("P")
R = TypeVar("R")

_LEAN: dict[str, Any] = {"nogil": True, "cache": True, "_nrt": False}


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The same function as machine code, compiled at its first call and kept on disk.

    It runs without the interpreter lock, so other threads go on while it works. Arguments must be
    plain numbers and contiguous arrays; the first call of a machine takes seconds (`warm_up`).
    """
    return cast("Callable[P, R]", numba.njit(nogil=True, cache=True)(function))


def lean(function: Callable[P, R]) -> Callable[P, R]:
    """As `compiled`, for functions that make no arrays and call none that do.

    Compiled code counts the references to every array of a call, up and down, by instructions that lock
    memory; a lookup of an edge took half its time so. Who makes nothing need not count. Making an array
    in such a function does not compile.
    """
    return cast("Callable[P, R]", numba.njit(**_LEAN)(function))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """As `lean`, and written out wherever it is called: for what is called a hundred thousand times a look,
    where handing over the arrays costs as much as the work."""
    return cast("Callable[P, R]", numba.njit(**_LEAN, forceinline=True)(function))


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
