"""Where several files here start: a journal, written scenes, a loop over doubles, a handshake in course."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cell import cycle
from cell.journal import Journal
from tests.fakes.station import bench, scene
from tests.unit.cell.dialogue import WORKING, Dialogue
from tests.unit.cell.looped import Cell
from tests.unit.cell.scripted import FREE, Eyes
from vision.types import Scene


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    made = Journal(tmp_path / "journal.sqlite")
    made.open()
    made.boot()
    yield made
    made.close()


@pytest.fixture
def see(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Eyes]:
    """Give the detector's answers: ``see(scene(...), ...)``."""

    def use(*scenes: Scene | Exception) -> Eyes:
        eyes = Eyes(list(scenes))
        monkeypatch.setattr(cycle, "locate", eyes)
        return eyes

    return use


@pytest.fixture
def cell(tmp_path: Path, journal: Journal, see: Callable[..., Eyes]) -> Cell:
    """A loop over scripted doubles that sees one free part."""
    see(scene(FREE))
    return Cell(bench(pictures=8), journal, tmp_path / "journal.sqlite")


@pytest.fixture
def ready() -> Dialogue:
    """A cell in which link is up, enable is high and nothing is wanted."""
    d = Dialogue()
    d.polls(2)
    assert d.ready()
    d.events.clear()
    return d


@pytest.fixture
def busy(ready: Dialogue) -> Dialogue:
    """Order 5 is in flight."""
    ready.show(5)
    ready.polls(2)
    ready.report = WORKING
    assert [o.request_id for o in ready.orders] == [5]
    ready.events.clear()
    return ready
