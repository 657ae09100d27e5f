"""The cell as the Modbus TCP server (map v1, role A): a PLC polls it.

An exchange shows the PLC the status block and is over when the PLC has read it; what it has written by then
is the command block. So the two roles behave alike above this line: each exchange was really seen by the
PLC, and a PLC that stops polling costs a time limit. Whether the PLC lives is never told by its connection:
it may open one for each request, or keep one open long after its program stands.
"""

from __future__ import annotations

import threading
from concurrent.futures import Future
from typing import Final

import structlog

from drivers.errors import DeviceTimeout, DeviceUnavailable
from drivers.plc.modbus_server import ListeningFailed, Server
from drivers.plc.served import ServedRegisters
from drivers.plc_codec import decode_command, encode_status, encode_test
from drivers.plc_map import COMMAND_WORDS
from drivers.settings import ModbusServerPlcSettings
from drivers.timing import Clock
from drivers.types import PlcInputs, PlcOutputs

log = structlog.get_logger(part="plc")

_START_S: Final = 5.0
_END_S: Final = 2.0


class ModbusServerPlc:
    """Satisfies `drivers.interfaces.Plc`.

    `open` listens or raises; then a thread of its own serves until `close`. `exchange` waits for the PLC at
    most ``settings.timeout_s``.
    """

    def __init__(self, name: str, settings: ModbusServerPlcSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._registers = ServedRegisters(clock, encode_test(settings.word_order))
        self._server: Server | None = None
        self._thread: threading.Thread | None = None

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    @property
    def refused(self) -> int:
        """Connections closed at once since `open`: not on the list, or too many."""
        return 0 if self._server is None else self._server.refused

    def open(self) -> None:
        """Listen.

        Raises
        ------
        DeviceUnavailable
            The address cannot be listened on; nothing is left behind.
        """
        if self._thread is not None:
            return
        # what a PLC wrote before is not believed: it may have gone on meanwhile
        self._registers = ServedRegisters(self._clock, encode_test(self._settings.word_order))
        self._start()

    def close(self) -> None:
        """Hang up and stop listening; may come twice."""
        server, thread = self._server, self._thread
        self._server = self._thread = None
        if server is None or thread is None:
            return
        server.end()
        thread.join(_END_S)
        if thread.is_alive():
            log.error("plc_server_did_not_end", within_s=_END_S)
        if server.refused:
            log.info("plc_server_ended", connections_refused=server.refused)

    def exchange(self, outputs: PlcOutputs) -> PlcInputs:
        """Show the status block, wait until the PLC has read its status word, take the command block.

        Returns
        -------
        PlcInputs
            ``read_at`` is the moment at which the PLC asked.

        Raises
        ------
        DeviceUnavailable
            Not open, or the server has ended and cannot listen again.
        DeviceTimeout
            The PLC did not read the status word in time, or has not written the whole command block yet.
        ValueError
            A field of ``outputs`` does not fit its register; nothing was shown.
        """
        if self._thread is None:
            raise DeviceUnavailable(self._name, "not open")
        words = encode_status(outputs, self._settings.word_order)
        fetched = self._registers.show(words)
        if not self._thread.is_alive():
            log.error("plc_server_restarted")
            self._start()
        if not self._clock.wait(fetched, self._settings.timeout_s):
            raise DeviceTimeout(self._name, self._silence())
        taken = self._registers.take()
        if taken.unwritten:
            raise DeviceTimeout(
                self._name,
                f"the PLC has not written {_ranges(taken.unwritten)} of the command block since the start; "
                f"it must write all {COMMAND_WORDS}",
            )
        return decode_command(taken.words, taken.fetched_at, self._settings.word_order)

    def _silence(self) -> str:
        s = self._settings
        connected = 0 if self._server is None else self._server.connected
        who = f"{connected} connected, but nobody" if connected else "nobody is connected, so nobody"
        return f"{who} has read the status word at {s.bind}:{s.port} for {s.timeout_s:g} s"

    def _start(self) -> None:
        s = self._settings
        server = Server(s, self._registers)
        started: Future[None] = Future()
        thread = threading.Thread(target=server.run, args=(started,), name="plc-server", daemon=True)
        thread.start()
        try:
            started.result(_START_S)
        except ListeningFailed as error:
            thread.join(_END_S)
            raise DeviceUnavailable(self._name, f"cannot listen on {s.bind}:{s.port}: {error}") from error
        except TimeoutError as error:
            server.end()
            raise DeviceUnavailable(
                self._name, f"not listening on {s.bind}:{s.port} after {_START_S:g} s"
            ) from error
        self._server, self._thread = server, thread
        log.info("plc_server_listening", address=f"{s.bind}:{s.port}", peers=list(s.peers))


def _ranges(offsets: tuple[int, ...]) -> str:
    """Words 0-2, 5 and so on."""
    runs: list[list[int]] = []
    for offset in offsets:
        if runs and runs[-1][1] == offset - 1:
            runs[-1][1] = offset
        else:
            runs.append([offset, offset])
    return (
        "word " * (len(offsets) == 1)
        + "words " * (len(offsets) > 1)
        + ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)
    )
