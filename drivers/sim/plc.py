"""The simulated PLC, a process of its own, in either role: a Modbus TCP server with the registers of map v1,
or a client that polls the cell; the program of `drivers.sim.plc_program` is scanned every 10 ms beside it.

    python -m drivers.sim.plc --port 0 --orders until-empty --out summary.json
    python -m drivers.sim.plc --connect 127.0.0.1:5020 --orders until-empty --out summary.json

It prints one JSON line per event, ``{"event": "listening", "port": ...}`` (or ``"polling"``) first, and
writes a summary when it ends. Exit code 0: every handshake closed and no rule of the contract was broken;
1: not so; 2: usage.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import signal
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import cast

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.errors import CommandRejected
from drivers.plc_codec import WordOrder, decode_status, encode_command
from drivers.plc_map import COMMAND_WORDS, STATUS_WORDS, TEST_WORDS
from drivers.sim import arguments as cli
from drivers.sim.plc_client import CellRegisters, poll
from drivers.sim.plc_program import PlcProgram, Task, Value
from drivers.timing import Clock, MonotonicClock

SCAN_S = 0.01


class RegisterServer:
    """The registers on the wire. The cell may read everything and write the status block only, and the test
    registers where there are some.

    ``port`` 0 takes a free one; `listen` returns the one taken.
    """

    def __init__(
        self,
        program: PlcProgram,
        clock: Clock,
        *,
        host: str,
        port: int,
        command_base: int = 0,
        status_base: int = 100,
        test_base: int | None = None,
        word_order: WordOrder = "big",
    ) -> None:
        self._program = program
        self._clock = clock
        self._address = (host, port)
        self._command_base = command_base
        self._status_base = status_base
        self._test_base = test_base
        self._word_order = word_order
        self._status_words = [0] * STATUS_WORDS
        self.test_words = [0] * TEST_WORDS
        self._server: ModbusTcpServer | None = None

    async def listen(self) -> int:
        """Serve from now on, in the running event loop.

        Raises
        ------
        RuntimeError
            The address cannot be listened on.
        """
        blocks = [(self._command_base, COMMAND_WORDS), (self._status_base, STATUS_WORDS)]
        if self._test_base is not None:
            blocks.append((self._test_base, TEST_WORDS))
        device = SimDevice(
            id=0,
            simdata=[
                SimData(base, values=[0] * n, datatype=DataType.REGISTERS) for base, n in sorted(blocks)
            ],
            action=self._touched,
        )
        self._server = ModbusTcpServer(device, address=self._address, trace_connect=self._connected)
        await self._server.serve_forever(background=True)
        listener = cast(asyncio.Server, self._server.transport)
        return int(listener.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """Stop serving."""
        if self._server is not None:
            shutdown = cast("Callable[[], Awaitable[None]]", self._server.shutdown)
            await shutdown()
            self._server = None

    def _connected(self, connected: bool) -> None:
        if connected:
            self._program.rules.connected()

    async def _touched(
        self,
        function_code: int,  # noqa: ARG002 - the library calls with all six
        start: int,
        address: int,
        count: int,  # noqa: ARG002
        registers: list[int],
        written: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Called for every request: fills the command registers, or checks and takes a write."""
        if written is None:
            first = self._command_base - start
            registers[first : first + COMMAND_WORDS] = encode_command(self._program.command, self._word_order)
            return None
        if self._test_base is not None and 0 <= address - self._test_base < TEST_WORDS:
            offset = address - self._test_base
            self.test_words[offset : offset + len(written)] = [int(word) for word in written]
            return None
        offset = address - self._status_base
        if offset < 0 or offset + len(written) > STATUS_WORDS:
            return ExcCodes.ILLEGAL_ADDRESS
        self._status_words[offset : offset + len(written)] = [int(word) for word in written]
        status = decode_status(self._status_words, self._word_order)
        self._program.cell_wrote(status, self._clock.now())
        return None


class Lines:
    """One JSON object a line on stdout; a reader who has gone away does not stop the PLC."""

    def __init__(self) -> None:
        self._open = True

    def write(self, values: Mapping[str, Value]) -> None:
        if not self._open:
            return
        try:
            sys.stdout.write(json.dumps(values) + "\n")
            sys.stdout.flush()
        except BrokenPipeError:
            self._open = False
            sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - the interpreter flushes stdout at exit


def write_summary(path: Path, program: PlcProgram) -> None:
    """The result of the run as JSON, complete or not there at all."""
    codes = [order.code for order in program.orders]
    summary = {
        "ended": program.ended,
        "clean": program.clean,
        "orders": [asdict(order) for order in program.orders],
        "results_by_code": {
            str(code): codes.count(code) for code in sorted({c for c in codes if c is not None})
        },
        "handshake_errors": program.violations,
        "cell_restarts": program.rules.restarts,
        "longest_cell_beat_s": round(program.rules.longest_beat_s, 3),
    }
    partial = path.with_name(path.name + ".part")
    with partial.open("w") as file:
        json.dump(summary, file, indent=1)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def _unwritable(path: Path | None) -> str | None:
    """Why no summary could be written there, known before the run and not after it."""
    if path is None or (path.parent.is_dir() and os.access(path.parent, os.W_OK) and not path.is_dir()):
        return None
    return f"--out {path}: no file can be written there; give a file in a folder that exists"


async def serve(program: PlcProgram, server: RegisterServer, clock: Clock, out: Path | None) -> int:
    """Scan until the program has ended or a signal comes; returns the exit code."""
    lines = Lines()
    asked_to_end = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, asked_to_end.set)
    lines.write({"event": "listening", "port": await server.listen(), "at": clock.now()})
    next_scan = loop.time()
    while program.ended is None:
        program.scan(clock.now())
        if asked_to_end.is_set():
            program.stop("asked to end", clock.now())
        for event in program.events():
            lines.write({"event": event.name, "at": event.at, **dict(event.values)})
        next_scan = max(next_scan + SCAN_S, loop.time())
        try:
            await asyncio.wait_for(asked_to_end.wait(), next_scan - loop.time())
        except TimeoutError:
            continue
    await server.close()
    if out is not None:
        write_summary(out, program)
    return 0 if program.clean else 1


def _orders(text: str) -> int | None:
    if text == "until-empty":
        return None
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number above 0 nor 'until-empty'")
    return int(text)


def _peer(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT")
    return host, cli.port(port)


def _base(text: str) -> int:
    base = cli.word(text)
    if base + STATUS_WORDS > 65535:
        raise argparse.ArgumentTypeError(f"a block at {text} does not end below register 65535")
    return base


def arguments(argv: Sequence[str]) -> argparse.Namespace:
    """The command line."""
    parser = cli.Parser(prog="python -m drivers.sim.plc", description="A PLC that orders picks.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument(
        "--port", type=cli.port, default=0, help="0: any free one, see the first line printed"
    )
    parser.add_argument(
        "--connect", type=_peer, metavar="HOST:PORT", help="be the client and poll the cell there"
    )
    parser.add_argument("--orders", type=_orders, default=None, metavar="N|until-empty")
    parser.add_argument("--out", type=Path, help="write a JSON summary here at the end")
    parser.add_argument(
        "--command", type=cli.word, default=3, help="cmd_code of the orders (3 pick and place)"
    )
    parser.add_argument("--part", type=cli.word, default=1, help="part code")
    parser.add_argument("--attempts", type=cli.word, default=3)
    parser.add_argument("--speed-percent", type=cli.word, default=0, help="0: the cell's default")
    parser.add_argument("--pause-s", type=cli.not_negative, default=0.0, help="pause between two orders")
    parser.add_argument(
        "--deadline-s", type=cli.positive, default=60.0, help="longest wait for ready, and per order"
    )
    parser.add_argument("--crc", action="store_true", help="write the check word")
    parser.add_argument("--word-order", choices=("big", "little"), default="big")
    parser.add_argument("--command-base", type=_base, default=0)
    parser.add_argument("--status-base", type=_base, default=100)
    parser.add_argument("--test-base", type=_base, help="room for the cell's test registers")
    options = parser.parse_args(argv)
    blocks = [(options.command_base, COMMAND_WORDS), (options.status_base, STATUS_WORDS)]
    if options.test_base is not None:
        blocks.append((options.test_base, TEST_WORDS))
    for first, second in pairwise(sorted(blocks)):
        if first[0] + first[1] > second[0]:
            parser.error(
                f"the blocks at {first[0]} and {second[0]} overlap: the first has {first[1]} registers"
            )
    return options


def _poll(program: PlcProgram, args: argparse.Namespace, clock: Clock) -> int:
    """The client's role; returns the exit code."""
    host, port = args.connect
    lines = Lines()
    lines.write({"event": "polling", "ready": True, "host": host, "port": port, "at": clock.now()})
    try:
        poll(program, CellRegisters(host, port, args.word_order), clock, lines.write)
    except CommandRejected as error:
        sys.stderr.write(f"simulated PLC: {error}\n")
        return 1
    if args.out is not None:
        write_summary(args.out, program)
    return 0 if program.clean else 1


def main(argv: Sequence[str]) -> int:
    """Run the simulated PLC with these arguments; returns the exit code."""
    args = arguments(argv)
    refused = _unwritable(args.out)
    if args.connect is None:
        refused = cli.refusal(args.host, args.port) or refused
    if refused is not None:
        sys.stderr.write(f"simulated PLC: {refused}\n")
        return cli.EXIT_USAGE
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # what matters is printed as events
    clock = MonotonicClock()
    program = PlcProgram(
        Task(
            orders=args.orders,
            command=args.command,
            part=args.part,
            max_attempts=args.attempts,
            speed_percent=args.speed_percent,
            use_crc=args.crc,
            pause_s=args.pause_s,
            deadline_s=args.deadline_s,
        )
    )
    if args.connect is not None:
        return _poll(program, args, clock)
    server = RegisterServer(
        program,
        clock,
        host=args.host,
        port=args.port,
        command_base=args.command_base,
        status_base=args.status_base,
        test_base=args.test_base,
        word_order=args.word_order,
    )
    try:
        return asyncio.run(serve(program, server, clock, args.out))
    except (RuntimeError, OSError) as error:
        sys.stderr.write(f"simulated PLC at {args.host}:{args.port}: {error}\n")
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
