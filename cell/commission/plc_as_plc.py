"""The PLC's side of the handshake against a daemon that is the Modbus server. Orders are pings: no motion.

Every answer the contract promises is asked for once: what is shown where, what may not be written, refusals
by code, a repeated number, hold, abort, a heartbeat that stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from cell.commission.plc_transcript import Transcript
from drivers.errors import CommandRejected, DriverError
from drivers.interfaces import CellServer
from drivers.plc_codec import WordOrder, encode_command, read_test
from drivers.plc_map import (
    COMMAND_WORDS,
    CRC_OFFSET,
    MAP_VERSION,
    SERVER_WINDOWS,
    STATUS,
    STATUS_WORDS,
    TEST_WORDS,
    Area,
    Block,
    Window,
    next_sequence,
    offset_of,
)
from drivers.timing import Clock, StopToken
from drivers.types import QUIET, PlcCommand, PlcOutputs, ResultCode

PERIOD_S: Final = 0.02
BEATS_S: Final = 2.5
STANDS_S: Final = 2.2
"""Longer than the 1.5 s after which a heartbeat that stands is a lost link."""
ANSWER_S: Final = 3.0

_QUIET: Final = replace(QUIET, cmd_code=int(PlcCommand.PING))


class PlcSide:
    """Writes the command block and reads the status block at every `poll`."""

    def __init__(self, cell: CellServer, clock: Clock, transcript: Transcript) -> None:
        self._cell = cell
        self._transcript = transcript
        self._stop = StopToken(clock)
        self.clock = clock
        self.command = _QUIET
        self.status = PlcOutputs(map_version=0)
        self.beating = True

    def poll(self) -> None:
        """One write and one read, the heartbeat counted."""
        began_at = self.clock.now()
        if self.beating:
            self.change(heartbeat=(self.command.heartbeat + 1) & 0xFFFF)
        self.status = self._cell.swap(self.command)
        took_s = self.clock.now() - began_at
        self._transcript.took("one write and one read", took_s)
        self._stop.wait(max(0.0, PERIOD_S - took_s))

    def change(self, **fields: bool | int) -> None:
        """Fields of the command block, written by the next `poll`."""
        self.command = replace(self.command, **fields)  # type: ignore[arg-type]  # names of its fields

    def until(self, condition: Callable[[PlcOutputs], bool], within_s: float) -> float | None:
        """Poll until the status is so; how long it took, None when the time was over."""
        began_at = self.clock.now()
        while True:
            self.poll()
            if condition(self.status):
                return self.clock.now() - began_at
            if self.clock.now() - began_at > within_s:
                return None


def play_plc(
    cell: CellServer, order: WordOrder, clock: Clock, transcript: Transcript, orders: int, wait_s: float
) -> None:
    """Lead the cell through the handshake; every step ends in the transcript."""
    side = PlcSide(cell, clock, transcript)
    try:
        if not (_connection(side, cell, transcript, order) and _registers(cell, transcript)):
            return
        _heartbeat(side, transcript)
        if not _ready(side, transcript, wait_s):
            return
        if not _pings(side, transcript, orders):
            return
        _repeat(side, transcript)
        _refusals(side, cell, transcript, order)
        _hold(side, transcript, wait_s)
        _abort(side, transcript, wait_s)
        _silence(side, transcript, wait_s)
    except DriverError as error:
        transcript.step("connection kept", False, error.detail, "look into the daemon's log")
    finally:
        _leave(side)
        cell.close()


def _leave(side: PlcSide) -> None:
    side.command = replace(side.command, enable=False, abort=False, hold=False, reset_fault=False)
    try:
        side.poll()
    except DriverError:
        return  # the transcript has said that the cell is gone


def _connection(side: PlcSide, cell: CellServer, transcript: Transcript, order: WordOrder) -> bool:
    try:
        side.poll()
    except DriverError as error:
        return transcript.step(
            "connection",
            False,
            error.detail,
            "start the daemon; this computer's address has to be in plc.peers",
        )
    transcript.step("connection", True, "command block written, status block read")
    good = transcript.step(
        "map version", side.status.map_version == MAP_VERSION, f"word 0 is {side.status.map_version}"
    )
    window = _window(Block.TEST, Area.INPUT_REGISTER)
    words = cell.read(window.area, window.first, TEST_WORDS)
    shown = read_test(words)
    return good and transcript.step(
        "test registers",
        shown == order,
        f"{' '.join(f'{word:04X}' for word in words)}: word order {shown or 'unknown'}",
        f"the file says word_order: {order}; is the daemon running with this file?",
    )


def _window(block: Block, area: Area) -> Window:
    return next(w for w in SERVER_WINDOWS if w.block is block and w.area is area)


def _registers(cell: CellServer, transcript: Transcript) -> bool:
    """The same data in every place, and nothing to be written but the command block."""
    mirror = _window(Block.STATUS, Area.HOLDING_REGISTER)
    for _ in range(5):  # the heartbeat may count between two reads
        inputs = cell.read(Area.INPUT_REGISTER, 0, STATUS_WORDS)
        holding = cell.read(Area.HOLDING_REGISTER, mirror.first, STATUS_WORDS)
        bits = cell.read(Area.DISCRETE_INPUT, 0, 16)
        again = cell.read(Area.INPUT_REGISTER, 0, STATUS_WORDS)
        if inputs == again:
            break
    same = inputs == holding and sum(on << i for i, on in enumerate(bits)) == inputs[2]
    transcript.step("mirrored status", same, "input registers, holding registers and discrete inputs agree")
    refused = []
    for address in (mirror.first, _window(Block.TEST, Area.HOLDING_REGISTER).first, COMMAND_WORDS):
        try:
            cell.write(address, [1])
        except CommandRejected:
            refused.append(address)
    return transcript.step(
        "writes outside the block", len(refused) == 3, f"refused at {', '.join(map(str, refused))}"
    )


def _heartbeat(side: PlcSide, transcript: Transcript) -> None:
    last, since, longest_s, beats = side.status.heartbeat, side.clock.now(), 0.0, 0
    ends_at = since + BEATS_S
    while side.clock.now() < ends_at:
        side.poll()
        now = side.clock.now()
        longest_s = max(longest_s, now - since)
        if side.status.heartbeat != last:
            beats, last, since = beats + 1, side.status.heartbeat, now
    transcript.step(
        "the cell's heartbeat",
        beats >= 2 and longest_s < 1.5,
        f"counted {beats} times in {BEATS_S:g} s, stood for {longest_s:.2f} s at most",
        "the daemon's loop stands: look into its log",
    )


def _ready(side: PlcSide, transcript: Transcript, wait_s: float, what: str = "enable, ready") -> bool:
    """Link, enable low and high, ready; a result nobody took is taken."""
    linked_s = side.until(lambda s: s.plc_link_ok, wait_s)
    if not transcript.step(
        "the cell hears us",
        linked_s is not None,
        "plc_link_ok is high" if linked_s is not None else f"plc_link_ok not high within {wait_s:g} s",
        "is another PLC writing the same registers? take it off the line for this test",
    ):
        return False
    if side.status.result_valid:
        side.change(result_ack_seq=side.status.result_seq)
        side.until(lambda s: not s.result_valid, ANSWER_S)
    side.change(enable=False)
    side.until(lambda s: not s.ready, ANSWER_S)
    side.until(lambda _s: False, 0.3)  # low for long enough to be read
    side.change(enable=True)
    took_s = side.until(lambda s: s.ready, wait_s)
    s = side.status
    return transcript.step(
        what,
        took_s is not None,
        f"ready {took_s:.2f} s after enable"
        if took_s is not None
        else f"not ready within {wait_s:g} s: {_why(s)}",
        "see the daemon's log; a fault is reset by control bit 3, once its cause is gone",
    )


def _why(status: PlcOutputs) -> str:
    told = [f"state {status.state}"]
    if status.fault:
        told.append(f"fault {status.fault_code}")
    told += [
        name
        for name in ("busy", "result_valid", "emergency_stop", "protective_stop", "safeguard_stop")
        if getattr(status, name)
    ]
    return ", ".join(told)


def _answered(side: PlcSide, sequence: int) -> float | None:
    return side.until(lambda s: s.accepted_seq == sequence, ANSWER_S)


def _next(side: PlcSide) -> int:
    """After the last number shown; while none is, the cell shows the last one it has taken."""
    return next_sequence(side.command.cmd_seq or side.status.accepted_seq)


def _pings(side: PlcSide, transcript: Transcript, orders: int) -> bool:
    done = 0
    for _ in range(orders):
        sequence = _next(side)
        side.change(cmd_code=int(PlcCommand.PING), cmd_seq=sequence)
        accepted_s = _answered(side, sequence)
        if accepted_s is None or side.status.ack_code:
            break
        result_s = side.until(lambda s, n=sequence: s.result_valid and s.result_seq == n, ANSWER_S)  # type: ignore[misc]
        if result_s is None or side.status.result_code != ResultCode.OK:
            break
        side.change(result_ack_seq=sequence)
        dropped_s = side.until(lambda s: not s.result_valid, ANSWER_S)
        ready_s = side.until(lambda s: s.ready, ANSWER_S)
        if dropped_s is None or ready_s is None:
            break
        transcript.took("cmd_seq written to accepted", accepted_s)
        transcript.took("accepted to result_valid (ping)", result_s)
        transcript.took("acknowledged to result dropped", dropped_s)
        done += 1
    s = side.status
    return transcript.step(
        "orders (ping)",
        done == orders,
        f"{done} of {orders}: accepted, result, acknowledged, ready again"
        + (
            ""
            if done == orders
            else f"; then accepted_seq {s.accepted_seq}, ack_code {s.ack_code}, {_why(s)}"
        ),
        "see the daemon's log",
    )


def _repeat(side: PlcSide, transcript: Transcript) -> None:
    """The number stays; then it is shown anew after a 0: it must not be executed again."""
    sequence, picks = side.command.cmd_seq, side.status.total_picks
    side.change(cmd_seq=0)
    side.until(lambda _s: False, 0.3)
    side.change(cmd_seq=sequence)
    busy_s = side.until(lambda s: s.busy, 1.0)
    s = side.status
    transcript.step(
        "the same number again",
        busy_s is None and s.total_picks == picks and (s.accepted_seq, s.ack_code) == (sequence, 0),
        f"{sequence} is answered as accepted and not executed again",
    )


def _refusals(side: PlcSide, cell: CellServer, transcript: Transcript, order: WordOrder) -> None:
    for what, code, fields in (
        ("an unknown command", ResultCode.UNKNOWN_COMMAND, {"cmd_code": 99}),
        ("a speed of 101 %", ResultCode.BAD_PARAMETER, {"speed_percent": 101}),
        ("map version 2", ResultCode.MAP_VERSION, {"map_version": 2}),
    ):
        before = side.command
        sequence = _next(side)
        side.change(**fields, cmd_seq=sequence)
        took_s = _answered(side, sequence)
        _refused(side, transcript, what, code, took_s)
        side.command = replace(before, cmd_seq=sequence, heartbeat=side.command.heartbeat)
    # a wrong check word: the records cannot write one, so these words are written by hand
    sequence = _next(side)
    words = encode_command(replace(side.command, cmd_seq=sequence, crc_used=True), order)
    words[CRC_OFFSET] ^= 1 if words[CRC_OFFSET] != 1 else 2
    began_at = side.clock.now()
    took_s = None
    window, accepted = _window(Block.STATUS, Area.INPUT_REGISTER), offset_of(STATUS, "accepted_seq")
    while took_s is None and side.clock.now() - began_at < ANSWER_S:
        words[1] = (words[1] + 1) & 0xFFFF
        cell.write(0, words)
        if cell.read(window.area, window.first, STATUS_WORDS)[accepted] == sequence:
            took_s = side.clock.now() - began_at
        StopToken(side.clock).wait(PERIOD_S)
    side.change(cmd_seq=sequence, heartbeat=words[1])
    side.poll()
    _refused(side, transcript, "a wrong check word", ResultCode.CRC, took_s)


def _refused(
    side: PlcSide, transcript: Transcript, what: str, code: ResultCode, took_s: float | None
) -> None:
    found = side.status.ack_code
    transcript.step(
        what,
        took_s is not None and found == code,
        f"refused with {found}" if took_s is not None else "not answered",
        f"{int(code)} was to be expected",
    )


def _hold(side: PlcSide, transcript: Transcript, wait_s: float) -> None:
    side.until(lambda s: s.ready, wait_s)
    side.change(hold=True)
    off_s = side.until(lambda s: not s.ready, ANSWER_S)
    side.change(hold=False)
    on_s = side.until(lambda s: s.ready, wait_s)
    transcript.step(
        "hold",
        None not in (off_s, on_s),
        f"ready goes off, and comes back when hold is low: {_why(side.status)}",
    )


def _abort(side: PlcSide, transcript: Transcript, wait_s: float) -> None:
    """Abort, then a reset: what is opened again then may take its time."""
    side.change(abort=True)
    off_s = side.until(lambda s: not s.ready, ANSWER_S)
    side.until(lambda _s: False, 0.3)
    side.change(abort=False)
    side.until(lambda _s: False, 0.3)
    for level in (False, True, False):
        side.change(reset_fault=level)
        side.until(lambda _s: False, 0.3)
    on_s = side.until(lambda s: s.ready, wait_s)
    transcript.step(
        "abort, reset",
        None not in (off_s, on_s),
        f"ready goes off, and comes back after a rising edge of reset_fault: {_why(side.status)}",
        "see the daemon's log",
    )


def _silence(side: PlcSide, transcript: Transcript, wait_s: float) -> None:
    """Our heartbeat stands though we go on polling: the link is lost all the same."""
    side.beating = False
    lost_s = side.until(lambda s: not s.plc_link_ok, STANDS_S + 1.0)
    side.beating = True
    back_s = side.until(lambda s: s.plc_link_ok, wait_s)
    early_s = side.until(lambda s: s.ready, 0.5)
    good = None not in (lost_s, back_s) and early_s is None
    transcript.step(
        "a heartbeat that stands",
        good,
        f"link lost after {lost_s:.2f} s, not ready before enable was low"
        if lost_s is not None and good
        else f"link lost: {lost_s}, back: {back_s}, ready too early: {early_s}",
    )
    _ready(side, transcript, wait_s, "enable low and high again")
