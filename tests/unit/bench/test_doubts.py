"""The bench of doubts: what it counts as wrong is what the truth says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench import own
from bench.doubts import Look, Told, count, look, sheets

LOOK = look(own.cases("H10", 1, 11)[0])


def counted(one: Look = LOOK) -> Told:
    told = Told()
    count(one, told)
    return told


def test_every_part_is_told_by_its_sign_and_every_view_by_its_profile() -> None:
    told = counted()
    clear = [row for row in range(len(LOOK.true)) if not (LOOK.over.above[:, row] > 0).any()]

    assert told.signs["all of them"][0] == len(clear) > 0
    strains = [number for name, (number, _) in told.signs.items() if name.startswith("flanks contradict")]
    assert sum(strains) == len(clear)
    right = sum(true >= 0 for true in LOOK.true)
    assert told.inside[0] == right
    assert right <= sum(len(off) for off in told.missed.values()) <= 2 * right
    assert sum(number for number, _ in told.orders.values()) > 5


def test_where_the_truth_is_the_other_way_round_every_order_is_wrong() -> None:
    truth = LOOK.case.truth
    turned = tuple(replace(one, above=one.below, below=one.above) for one in truth.crossings)
    other = replace(LOOK, case=replace(LOOK.case, truth=replace(truth, crossings=turned)))

    for name, (number, wrong) in counted().orders.items():
        assert counted(other).orders[name] == [number, number - wrong]


def test_what_is_no_part_or_has_something_on_it_is_wrong() -> None:
    truth = LOOK.case.truth
    under = tuple(replace(part, free=False) for part in truth.parts)
    covered = replace(LOOK, case=replace(LOOK.case, truth=replace(truth, parts=under)))
    nothing = replace(LOOK, true=[-1] * len(LOOK.true))

    for one in (covered, nothing):
        for number, wrong in counted(one).signs.values():
            assert wrong == number


def test_the_tables_tell_numbers_and_shares() -> None:
    made = sheets(counted(), 1, "command")

    number, wrong = counted().signs["all of them"]
    assert made[0].rows[0] == ("all of them", str(number), str(wrong), f"{100 * wrong / number:.1f}")
    assert [len(sheet.rows) > 0 for sheet in made] == [True] * 4


@pytest.mark.parametrize("place", [0, 1, 2])
def test_nothing_counted_is_no_division_by_nothing(place: int) -> None:
    assert sheets(Told(), 0, "command")[place].rows == ()
