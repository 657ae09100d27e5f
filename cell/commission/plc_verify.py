"""`mikado plc verify`: which side is played, with which settings, in what words."""

from __future__ import annotations

from typing import assert_never

from rich.console import Console

from cell.commission.plc_as_cell import play_cell
from cell.commission.plc_as_plc import play_plc
from cell.commission.plc_transcript import Transcript
from cell.errors import UsageError
from drivers.factory import Factory
from drivers.settings import ModbusPlcSettings, ModbusServerPlcSettings, PlcSettings
from drivers.timing import MonotonicClock


def verify(
    settings: PlcSettings, *, as_plc: bool, orders: int, wait_s: float, bits: bool, console: Console
) -> int:
    """Walk through the handshake without moving anything; the exit code.

    Raises
    ------
    UsageError
        The PLC's side can be played only where the cell is the server.
    """
    clock = MonotonicClock()
    factory = Factory(clock)
    transcript = Transcript(console)
    match settings:
        case ModbusServerPlcSettings() if as_plc:
            transcript.head(
                f"As the PLC, polling the cell at {settings.bind}:{settings.port}; orders are pings"
            )
            play_plc(factory.cell_server(settings), settings.word_order, clock, transcript, orders, wait_s)
        case ModbusServerPlcSettings():
            transcript.head(
                f"As the cell, listening on {settings.bind}:{settings.port} for {', '.join(settings.peers)}; "
                "no robot is there"
            )
            play_cell(factory.plc("plc", settings), clock, transcript, orders, wait_s, bits)
        case ModbusPlcSettings():
            if as_plc:
                raise UsageError(
                    "--as-plc needs plc.driver: modbus_server; where the PLC is the server the simulated one "
                    "plays it: python -m drivers.sim.plc"
                )
            transcript.head(
                f"As the cell, polling the PLC at {settings.host}:{settings.port}; no robot is there"
            )
            play_cell(factory.plc("plc", settings), clock, transcript, orders, wait_s, bits)
        case _:
            assert_never(settings)
    return transcript.end()
