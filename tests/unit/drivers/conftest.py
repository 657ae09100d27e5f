"""A simulated UR controller at its home place, and a client whose program runs on it."""

from __future__ import annotations

import pytest

from drivers.sim.ur_core import Core, Setup
from tests.unit.drivers.ur_client import HOME, Client


@pytest.fixture
def core() -> Core:
    return Core(Setup(start_q=HOME))


@pytest.fixture
def client(core: Core) -> Client:
    return Client(core).upload()
