"""Cases from our own renderer: dense piles of 640 x 480, and 200 parts in five megapixels."""

from __future__ import annotations

import secrets
from functools import lru_cache

import numpy as np

from bench.cases import Case, of_piles
from bench.scenes import WORLD, Piles, render

SPREAD = 0.4


def fresh_seed() -> int:
    """A seed nobody has chosen."""
    return secrets.randbelow(2**31)


@lru_cache(maxsize=16)
def dense(sticks: int, count: int, seed: int) -> tuple[Case, ...]:
    """``count`` dense piles of so many sticks; every seed gives other ones."""
    first = int(np.random.default_rng([seed, sticks]).integers(2**31))
    return of_piles(f"N={sticks}", render(sticks, range(first, first + count), SPREAD))
