"""One simulated cell for every test that neither kills nor empties it, and a PLC for each test."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.fakes.simcell import SimCell, sim_cell
from tests.system.handplc import HandPlc, hand_plc
from tests.system.processes import SPEED
from vision.default import warm_up


@pytest.fixture(scope="session", autouse=True)
def compiled_detector() -> None:
    """Daemons have limits for getting ready; what a new machine takes to compile is not under test."""
    warm_up()


@pytest.fixture(scope="session")
def shared_cell() -> Iterator[SimCell]:
    with sim_cell("--speed", SPEED, "--seed", "7", "--sticks", "12") as running:
        yield running


@pytest.fixture
def cell(shared_cell: SimCell) -> SimCell:
    """The shared cell without faults. What it counted before a test is history: compare, do not assume 0."""
    shared_cell.mend()
    return shared_cell


@pytest.fixture
def plc() -> Iterator[HandPlc]:
    with hand_plc() as running:
        yield running
