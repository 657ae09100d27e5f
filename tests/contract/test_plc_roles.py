"""The words behind `drivers.interfaces.Plc`, kept by the double and by the Modbus drivers of both roles over
real sockets. What is special to a role is in `test_plc.py` (the PLC is the server) and `test_plc_server.py`.

Real time passes here because time limits are the subject; every wait ends by an event or by its limit.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from drivers.errors import DeviceTimeout, DeviceUnavailable
from drivers.interfaces import Plc
from drivers.plc.modbus import ModbusPlc
from drivers.plc.server import ModbusServerPlc
from drivers.settings import ModbusPlcSettings, ModbusServerPlcSettings
from drivers.timing import MonotonicClock
from drivers.types import PlcOutputs
from tests.fakes.clock import FakeClock
from tests.fakes.modbuswire import bare, obliging, polling, silent
from tests.fakes.plc import IDLE, FakePlc
from tests.fakes.ports import free_port

LIMIT_S = 0.2
MARGIN_S = 0.3
CLOCK = MonotonicClock()


@contextlib.contextmanager
def modbus(port: int) -> Iterator[ModbusPlc]:
    """The PLC as the server."""
    settings = ModbusPlcSettings(driver="modbus", host="127.0.0.1", port=port, timeout_s=LIMIT_S)
    plc = ModbusPlc("plc", settings, CLOCK)
    try:
        yield plc
    finally:
        plc.close()


@contextlib.contextmanager
def serving(port: int, timeout_s: float = LIMIT_S) -> Iterator[ModbusServerPlc]:
    """The cell as the server."""
    settings = ModbusServerPlcSettings(
        driver="modbus_server", bind="127.0.0.1", port=port, peers=("127.0.0.1",), timeout_s=timeout_s
    )
    plc = ModbusServerPlc("plc", settings, CLOCK)
    try:
        yield plc
    finally:
        plc.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class Role:
    """A driver, and peers for it that do what they should and that are there and say nothing."""

    plc: Plc
    obliging: Callable[[], contextlib.AbstractContextManager[object]]
    silent: Callable[[], contextlib.AbstractContextManager[object]]


@pytest.fixture(params=["cell polls", "PLC polls"])
def role(request: pytest.FixtureRequest) -> Iterator[Role]:
    """Both roles over real sockets, with nobody at the other end yet."""
    port = free_port()
    if request.param == "cell polls":
        with modbus(port) as client:
            yield Role(plc=client, obliging=lambda: bare(obliging, port), silent=lambda: bare(silent, port))
        return
    with serving(port) as server:
        yield Role(
            plc=server,
            obliging=lambda: polling(port),
            silent=lambda: socket.create_connection(("127.0.0.1", port)),
        )


@pytest.fixture(params=["modbus", "modbus_server", "scripted"])
def plc(request: pytest.FixtureRequest) -> Iterator[Plc]:
    if request.param == "scripted":
        yield FakePlc(FakeClock(), [IDLE])
        return
    if request.param == "modbus":
        with bare(obliging) as server, modbus(server.port) as plc:
            yield plc
        return
    port = free_port()
    with serving(port) as plc, polling(port):
        yield plc


def test_an_open_plc_exchanges_and_may_be_closed_twice_and_opened_again(plc: Plc) -> None:
    plc.open()
    assert plc.exchange(PlcOutputs()).map_version == 1
    plc.close()
    plc.close()
    plc.open()
    assert plc.exchange(PlcOutputs()).map_version == 1


def test_closing_what_was_never_opened_is_allowed(plc: Plc) -> None:
    plc.close()
    assert plc.name == "plc"


def test_a_closed_plc_exchanges_nothing(role: Role) -> None:
    with pytest.raises(DeviceUnavailable, match="not open"):
        role.plc.exchange(PlcOutputs())


def test_whoever_comes_after_open_is_found_by_the_next_exchange(role: Role) -> None:
    with contextlib.suppress(DeviceUnavailable):  # only a client can know at once that nobody is there
        role.plc.open()
    with pytest.raises((DeviceUnavailable, DeviceTimeout)):
        role.plc.exchange(PlcOutputs())
    with role.obliging():
        for _ in range(3):
            assert role.plc.exchange(PlcOutputs()).map_version == 1


def test_whoever_is_there_and_says_nothing_costs_the_time_limit_and_no_more(role: Role) -> None:
    with contextlib.suppress(DeviceUnavailable):
        role.plc.open()
    with role.silent():
        for _ in range(3):
            started = time.monotonic()
            with pytest.raises(DeviceTimeout):
                role.plc.exchange(PlcOutputs())
            assert LIMIT_S * 0.9 <= time.monotonic() - started < LIMIT_S + MARGIN_S


def test_whoever_goes_is_missed_and_found_again(role: Role) -> None:
    with contextlib.suppress(DeviceUnavailable):
        role.plc.open()
    for _ in range(2):
        with role.obliging():
            assert role.plc.exchange(PlcOutputs()).map_version == 1
        with pytest.raises((DeviceUnavailable, DeviceTimeout)):
            role.plc.exchange(PlcOutputs())


def test_what_was_read_is_no_younger_than_the_answer(role: Role) -> None:
    with contextlib.suppress(DeviceUnavailable):
        role.plc.open()
    with role.obliging():
        asked_at = time.monotonic()
        got = role.plc.exchange(PlcOutputs())
        assert asked_at <= got.read_at <= time.monotonic()


def test_outputs_that_do_not_fit_are_refused_in_either_role(role: Role) -> None:
    with contextlib.suppress(DeviceUnavailable):
        role.plc.open()
    with role.obliging(), pytest.raises(ValueError, match=r"status\.result_detail: 70000"):
        role.plc.exchange(PlcOutputs(result_detail=70000))
