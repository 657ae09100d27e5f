"""Tables fit a terminal, and a page of documentation."""

from __future__ import annotations

import pytest

from bench import accuracy, report, tables


def sheet(*notes: str) -> tables.Sheet:
    return tables.Sheet(
        title="Both",
        command="python -m bench.both",
        headings=("method", "recall\n%"),
        rows=(("ours", "99.5"), ("theirs", "-")),
        notes=notes,
    )


def test_a_page_has_the_command_the_cells_and_the_notes() -> None:
    lines = tables.page(sheet("A note.")).splitlines()
    assert lines[0] == "## Both"
    assert "`python -m bench.both`" in lines
    assert "| method | recall % |" in lines
    assert "|---|---:|" in lines
    assert "| ours | 99.5 |" in lines
    assert lines[-1] == "A note."


def test_a_note_of_several_tables_is_told_once() -> None:
    page = report.page(
        [sheet("Same.", "One."), sheet("Same.", "Two.")], (("seed", "3"),), "make bench", False
    )
    assert page.count("Same.") == 1
    assert page.index("One.") < page.index("Two.")
    assert "| seed | 3 |" in page


@pytest.mark.parametrize(
    ("share", "told"), [(1.0, "100"), (0.9996, "99.96"), (0.995, "99.5"), (0.42, "42"), (float("nan"), "-")]
)
def test_a_share_just_below_all_is_not_rounded_to_all(share: float, told: str) -> None:
    assert tables.percent(share) == told


def test_the_widest_accuracy_table_fits_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    shares = ("98", "100", "99.5", "100", "99.5", "98/100")
    rows = (
        (
            "H40 (20)",
            "default",
            *shares,
            "1.37/3.03",
            "2.9/7.1",
            "1.57/4.35",
            "95/100",
            "984",
            "1234",
            "220",
        ),
    )
    assert len(rows[0]) == len(accuracy.HEADINGS)
    tables.show(tables.Sheet(title="t", command="c", headings=accuracy.HEADINGS, rows=rows))
    shown = capsys.readouterr().out
    assert "…" not in shown
    assert max(len(line) for line in shown.splitlines()) <= tables.COLUMNS


def test_nothing_measured_is_told_as_a_dash() -> None:
    one = accuracy.row("A", "default", [])
    assert accuracy.cells(one)[2:] == ("-",) * (len(accuracy.HEADINGS) - 2)
