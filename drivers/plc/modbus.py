"""A PLC that is a Modbus TCP server (map v1, role B): one exchange per call, every answer checked.

One exchange writes the status block with one FC16 and then reads the command block with one FC3. The write
is a single one on purpose: which words change together is decided by the handshake, which never lets
"result valid" and the words it covers change in the same exchange, so a PLC that copies the block word by
word cannot see a torn result and no second write is needed.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Protocol, cast

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException, ModbusIOException

from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.plc_codec import decode_command, encode_status, encode_test
from drivers.plc_map import COMMAND_WORDS
from drivers.settings import ModbusPlcSettings
from drivers.timing import Clock
from drivers.types import PlcInputs, PlcOutputs

_REASONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledge",
    6: "device busy",
    10: "gateway path unavailable",
    11: "gateway target did not answer",
}
_CLOCK_GRAIN_S = 0.005


class _Answer(Protocol):
    """What we read of a vendor answer; only the fields of its own kind mean anything."""

    registers: list[int]
    address: int
    count: int
    exception_code: int

    def isError(self) -> bool: ...  # the vendor's spelling


class _Params(Protocol):
    timeout_connect: float


class _Client(Protocol):
    """The vendor calls we use (pymodbus 3.16)."""

    comm_params: _Params

    def connect(self) -> bool: ...

    def close(self) -> None: ...

    def read_holding_registers(self, address: int, *, count: int, device_id: int) -> _Answer: ...

    def write_registers(self, address: int, values: Sequence[int], *, device_id: int) -> _Answer: ...


class ModbusPlc:
    """Satisfies `drivers.interfaces.Plc`.

    `open` raises `DeviceUnavailable` when the PLC cannot be reached, and holds no connection then; the
    device is in use all the same, and every `exchange` without a connection makes one first. So the
    caller's loop is the only retry, and a PLC that comes later is found. After `close`, and before
    `open`, an exchange is refused.

    One exchange has ``settings.timeout_s`` for everything, connecting included; a peer that trickles
    bytes can take the same time once more. Whatever goes wrong on the line closes the connection, so a
    late answer can never be taken for the next one. ``settings.host`` should be an address: the time a
    name server takes is not bounded by this.
    """

    def __init__(self, name: str, settings: ModbusPlcSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._in_use = False
        self._client: _Client | None = None
        self._tested = False

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def open(self) -> None:
        """Connect.

        Raises
        ------
        DeviceUnavailable
            Nobody listens, or not within ``timeout_s``. Later exchanges try again.
        """
        _quieten_vendor_log()
        self._in_use = True
        if self._client is None:
            self._client = self._connected()

    def close(self) -> None:
        """Hang up; may come twice."""
        self._in_use = False
        self._hang_up()

    def exchange(self, outputs: PlcOutputs) -> PlcInputs:
        """Send the status block, then read the command block.

        Returns
        -------
        PlcInputs
            ``read_at`` is the moment before the read was sent: never later than the PLC's answer.

        Raises
        ------
        DeviceUnavailable
            Not open, not reachable, connection lost, or an answer that is not Modbus.
        DeviceTimeout
            No answer in time.
        CommandRejected
            The PLC answered with a Modbus exception, or with another block than the one asked for.
        ValueError
            A field of ``outputs`` does not fit its register; nothing was sent.
        """
        if not self._in_use:
            raise DeviceUnavailable(self._name, "not open")
        order = self._settings.word_order
        words = encode_status(outputs, order)
        ends_at = self._clock.now() + self._settings.timeout_s
        if self._client is None:
            self._client = self._connected()
        client, unit = self._client, self._settings.unit
        if self._settings.test_base is not None and not self._tested:
            self._write(client, self._settings.test_base, encode_test(order), ends_at)
            self._tested = True
        self._write(client, self._settings.write_base, words, ends_at)

        base = self._settings.read_base
        read_at = self._clock.now()
        answer = self._asked(
            f"read of {COMMAND_WORDS} registers at {base}",
            ends_at,
            lambda: client.read_holding_registers(base, count=COMMAND_WORDS, device_id=unit),
        )
        if len(answer.registers) != COMMAND_WORDS:
            raise self._mismatch(f"read of {COMMAND_WORDS} registers at {base}")
        return decode_command(answer.registers, read_at, order)

    def _write(self, client: _Client, base: int, words: Sequence[int], ends_at: float) -> None:
        what = f"write of {len(words)} registers at {base}"
        unit = self._settings.unit
        answer = self._asked(what, ends_at, lambda: client.write_registers(base, words, device_id=unit))
        if (answer.address, answer.count) != (base, len(words)):
            raise self._mismatch(what)

    def _connected(self) -> _Client:
        s = self._settings
        client = cast(_Client, ModbusTcpClient(s.host, port=s.port, timeout=s.timeout_s, retries=0))
        if not client.connect():
            client.close()
            raise DeviceUnavailable(
                self._name, f"no connection to {s.host}:{s.port} within {s.timeout_s:g} s"
            )
        return client

    def _asked(self, what: str, ends_at: float, call: Callable[[], _Answer]) -> _Answer:
        """The one place where a vendor call is made: its exceptions and error answers become ours."""
        client = self._client
        left_s = ends_at - self._clock.now()
        if client is None or left_s <= 0.0:
            self._hang_up()
            raise DeviceTimeout(self._name, f"no time left for a {what}")
        client.comm_params.timeout_connect = left_s
        try:
            answer = call()
        except ModbusIOException as error:
            self._hang_up()
            if self._clock.now() >= ends_at - _CLOCK_GRAIN_S:
                raise DeviceTimeout(
                    self._name, f"no answer to a {what} in {self._settings.timeout_s:g} s"
                ) from error
            raise DeviceUnavailable(self._name, f"no Modbus answer to a {what}: {error}") from error
        except (ModbusException, OSError) as error:
            self._hang_up()
            raise DeviceUnavailable(self._name, f"connection lost in a {what}") from error
        if answer.isError():
            reason = _REASONS.get(answer.exception_code, "unknown reason")
            raise CommandRejected(self._name, f"{what} refused: exception {answer.exception_code}, {reason}")
        return answer

    def _mismatch(self, what: str) -> CommandRejected:
        self._hang_up()
        return CommandRejected(self._name, f"the answer to a {what} is about something else")

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
        self._tested = False


def _quieten_vendor_log() -> None:
    """Everything pymodbus reports reaches our caller as an exception; without a handler it would also
    write on stderr at every poll. Somebody who has chosen a level keeps it."""
    logger = logging.getLogger("pymodbus")
    if logger.level == logging.NOTSET:
        logger.setLevel(logging.CRITICAL)
