"""Long runs, short by default so that they are run with everything else; `make soak` asks for long ones."""

from __future__ import annotations

import pytest

from vision.default import warm_up

SHORT = 6


@pytest.fixture(scope="session")
def picks(pytestconfig: pytest.Config) -> int:
    """How many parts a soak delivers."""
    asked: int | None = pytestconfig.getoption("--picks")
    return SHORT if asked is None else asked


@pytest.fixture(scope="session", autouse=True)
def compiled_detector() -> None:
    """What a new machine takes to compile is not under test."""
    warm_up()
