"""An arm on both wires, mended after each test, and a token nobody has fired."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from drivers.timing import StopToken
from tests.contract.arms import CLOCK
from tests.fakes.simcell import SimCell, sim_cell
from tests.fakes.ur_controller import UrController, ur_controller


@pytest.fixture(scope="module")
def running() -> Iterator[SimCell]:
    with sim_cell("--sticks", "0", "--speed", "4") as cell:
        yield cell


@pytest.fixture
def cell(running: SimCell) -> Iterator[SimCell]:
    yield running
    running.mend()


@pytest.fixture(scope="module")
def wire() -> Iterator[UrController]:
    with ur_controller() as controller:
        yield controller


@pytest.fixture
def controller(wire: UrController) -> Iterator[UrController]:
    yield wire
    wire.mend()


@pytest.fixture
def stop() -> StopToken:
    return StopToken(CLOCK)
