"""The cell as the Modbus server, an exchange in a thread, and the peer that is the PLC."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

from drivers.plc.server import ModbusServerPlc
from drivers.plc_codec import WordOrder
from drivers.settings import ModbusServerPlcSettings
from drivers.timing import MonotonicClock
from drivers.types import PlcInputs, PlcOutputs, ToolPose
from tests.fakes.modbuswire import (
    QUIET,
    read_words,
    write_words,
)
from tests.fakes.ports import free_port

CLOCK = MonotonicClock()
OUTPUTS = PlcOutputs(
    heartbeat=0x0102,
    ready=True,
    robot_link=True,
    operator_needed=True,
    state=6,
    pose=ToolPose(x=-0.1, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=1e-6),
    boot_id=0xABCD,
)


@contextlib.contextmanager
def serving(
    *,
    peers: tuple[str, ...] = ("127.0.0.1",),
    bind: str = "127.0.0.1",
    timeout_s: float = 0.3,
    word_order: WordOrder = "big",
    most: int = 4,
) -> Iterator[tuple[ModbusServerPlc, int]]:
    """An open driver and its port."""
    port = free_port()
    settings = ModbusServerPlcSettings(
        driver="modbus_server",
        bind=bind,
        port=port,
        peers=peers,
        timeout_s=timeout_s,
        word_order=word_order,
        max_connections=most,
    )
    plc = ModbusServerPlc("plc", settings, CLOCK)
    plc.open()
    try:
        yield plc, port
    finally:
        plc.close()


@contextlib.contextmanager
def connected(port: int, source: str = "127.0.0.1") -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", port), timeout=2.0, source_address=(source, 0)) as peer:
        yield peer


class Exchange:
    """One exchange in a thread, so that the test can be the PLC meanwhile."""

    def __init__(self, plc: ModbusServerPlc, outputs: PlcOutputs) -> None:
        self.inputs: PlcInputs | None = None
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, args=(plc, outputs), name="exchange")
        self._thread.start()

    def _run(self, plc: ModbusServerPlc, outputs: PlcOutputs) -> None:
        try:
            self.inputs = plc.exchange(outputs)
        except Exception as error:  # noqa: BLE001 - handed to the test
            self.error = error

    @property
    def over(self) -> bool:
        return not self._thread.is_alive()

    def end(self) -> PlcInputs:
        self._thread.join(5.0)
        assert self.over
        if self.error is not None:
            raise self.error
        assert self.inputs is not None
        return self.inputs


def shown(plc: ModbusServerPlc, peer: socket.socket, outputs: PlcOutputs) -> None:
    """Have the PLC shown these outputs."""
    write_words(peer, 0, QUIET)
    exchange = Exchange(plc, outputs)
    while not exchange.over:
        read_words(peer, 4, 0, 40)
    exchange.end()
