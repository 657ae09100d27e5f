"""The simulated PLC as a Modbus TCP client: writes its command block into the cell, reads the status."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Mapping, Sequence
from types import FrameType
from typing import Final, Protocol, cast

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from drivers.errors import CommandRejected, DeviceUnavailable
from drivers.plc_codec import WordOrder, decode_status, encode_command
from drivers.plc_map import SERVER_WINDOWS, Area, Block, Window
from drivers.sim.plc_program import PlcProgram, Value
from drivers.timing import Clock, StopRequested, StopToken
from drivers.types import PlcInputs, PlcOutputs

SCAN_S: Final = 0.01
_RETRY_S: Final = 0.2


class _Answer(Protocol):
    registers: list[int]
    bits: list[bool]
    exception_code: int

    def isError(self) -> bool: ...  # the vendor's spelling


class _Client(Protocol):
    """The vendor calls used here (pymodbus 3.16)."""

    def connect(self) -> bool: ...

    def close(self) -> None: ...

    def read_coils(self, address: int, *, count: int) -> _Answer: ...

    def read_discrete_inputs(self, address: int, *, count: int) -> _Answer: ...

    def read_holding_registers(self, address: int, *, count: int) -> _Answer: ...

    def read_input_registers(self, address: int, *, count: int) -> _Answer: ...

    def write_registers(self, address: int, values: Sequence[int]) -> _Answer: ...


class CellRegisters:
    """The cell's registers as a PLC sees them over the wire; every call makes a connection where none is.

    Raises
    ------
    DeviceUnavailable
        From every call: no connection, no answer, or a connection that was lost.
    CommandRejected
        From every call: the cell answered with a Modbus exception.
    """

    def __init__(self, host: str, port: int, word_order: WordOrder = "big", timeout_s: float = 1.0) -> None:
        self._where = (host, port)
        self._word_order: WordOrder = word_order
        self._timeout_s = timeout_s
        self._client: _Client | None = None

    def swap(self, command: PlcInputs) -> PlcOutputs:
        """Write the command block, then read the status block."""
        self.write(0, encode_command(command, self._word_order))
        return self.status()

    def status(self) -> PlcOutputs:
        """Read the status block."""
        window = window_of(Block.STATUS, Area.INPUT_REGISTER)
        return decode_status(self.read(window.area, window.first, window.count), self._word_order)

    def read(self, area: Area, address: int, count: int) -> list[int]:
        """Registers, or bits as 0 and 1."""
        client = self._connected()
        reads = {
            Area.COIL: client.read_coils,
            Area.DISCRETE_INPUT: client.read_discrete_inputs,
            Area.INPUT_REGISTER: client.read_input_registers,
            Area.HOLDING_REGISTER: client.read_holding_registers,
        }
        answer = self._asked(f"read of {count} at {address}", lambda: reads[area](address, count=count))
        if area in (Area.COIL, Area.DISCRETE_INPUT):
            return [int(bit) for bit in answer.bits[:count]]
        return answer.registers

    def write(self, address: int, words: Sequence[int]) -> None:
        """Holding registers, with one request."""
        client = self._connected()
        self._asked(
            f"write of {len(words)} at {address}", lambda: client.write_registers(address, list(words))
        )

    def close(self) -> None:
        """Hang up."""
        if self._client is not None:
            self._client.close()
            self._client = None

    @property
    def connected(self) -> bool:
        """There is a connection that has not failed yet."""
        return self._client is not None

    def _connected(self) -> _Client:
        if self._client is None:
            logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # our caller gets an exception
            host, port = self._where
            client = cast(_Client, ModbusTcpClient(host, port=port, timeout=self._timeout_s, retries=0))
            if not client.connect():
                client.close()
                raise DeviceUnavailable("cell", f"no connection to {host}:{port}")
            self._client = client
        return self._client

    def _asked(self, what: str, call: Callable[[], _Answer]) -> _Answer:
        try:
            answer = call()
        except (ModbusException, OSError) as error:
            self.close()
            raise DeviceUnavailable("cell", f"no answer to a {what}: {error}") from error
        if answer.isError():
            raise CommandRejected("cell", f"{what} refused: exception {answer.exception_code}")
        return answer


def window_of(block: Block, area: Area) -> Window:
    """Where the cell shows a block."""
    return next(w for w in SERVER_WINDOWS if w.block is block and w.area is area)


def poll(
    program: PlcProgram, cell: CellRegisters, clock: Clock, tell: Callable[[Mapping[str, Value]], None]
) -> None:
    """Scan the program and poll the cell until the program has ended or a signal comes."""
    asked_to_end = StopToken(clock)

    def ask(_number: int, _frame: FrameType | None) -> None:
        asked_to_end.stop("asked to end")

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, ask)
    pause_s = SCAN_S
    while program.ended is None:
        try:
            asked_to_end.wait(pause_s)
        except StopRequested as request:
            program.stop(request.reason, clock.now())
        program.scan(clock.now())
        pause_s = SCAN_S
        try:
            if not cell.connected:
                program.rules.connected()
            status = cell.swap(program.command)
        except DeviceUnavailable:
            pause_s = _RETRY_S  # the cell is restarting, or not there yet: its heartbeat says so
        else:
            program.cell_wrote(status, clock.now())
        for event in program.events():
            tell({"event": event.name, "at": event.at, **dict(event.values)})
    cell.close()
