"""Heaps of several products of our own renderer: each part that is found is the product that it is."""

from __future__ import annotations

import pytest

from bench.mixed import MIXES, Count, counted, heaps, see
from bench.rigs import WEBCAM


@pytest.mark.parametrize("mix", sorted(MIXES))
def test_in_mixed_heaps_nothing_is_taken_for_another_product(mix: str) -> None:
    total = Count()
    for heap in heaps(mix, WEBCAM, 2, seed=31):
        scene, _ = see(heap, heap.parts[0], heap.parts[1:])
        for part in heap.parts:
            total = total.plus(counted(heap, scene, part))

    assert total.mistaken == 0
    assert total.offered_right == total.offered
    assert total.hit >= 0.9 * total.asked
