"""Hostile peers of a Modbus server, and the question whether it minded: used for seconds and for a minute.

The frames are random, broken, cut, oversized, flooding or slow; none of them is a write a PLC might make, so
the command block has to stay as the real PLC wrote it.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.fakes.modbuswire import frame, read_pdu, words_of

Talk = Callable[[random.Random, socket.socket], None]


def harmless(pdu: bytes) -> bool:
    """False for what may be a write into the command block or its coils; that is not sent."""
    if len(pdu) < 5 or pdu[0] not in (5, 6, 15, 16, 22, 23):
        return True
    first = (
        struct.unpack(">H", pdu[5:7] if pdu[0] == 23 else pdu[1:3])[0]
        if len(pdu) >= 7
        else pdu[1] << 8 | pdu[2]
    )
    return bool(first > 23)


def random_pdu(chance: random.Random) -> bytes:
    """Any function code, often a served one, with bytes that are plausible or not."""
    function = chance.choice([*range(1, 25), 43, 0, 0x80, 0x81, 0xFF, chance.randrange(256)])
    address = chance.choice(
        [0, 1, 15, 16, 22, 24, 39, 40, 99, 100, 139, 140, 200, 207, 65535, chance.randrange(65536)]
    )
    count = chance.choice([0, 1, 2, 24, 40, 123, 125, 126, 2000, 2001, 65535, chance.randrange(65536)])
    tail = chance.randbytes(chance.choice([0, 1, 2, 3, 5, 48, 246, chance.randrange(247)]))
    return (bytes([function]) + words_of([address, count]) + tail)[: chance.choice([1, 2, 4, 5, 253])]


def random_frames(chance: random.Random, peer: socket.socket) -> None:
    """Whole frames with nonsense inside; the answers are read."""
    for _ in range(50):
        pdu = random_pdu(chance)
        if harmless(pdu):
            peer.sendall(frame(pdu, transaction=chance.randrange(65536), unit=chance.randrange(256)))
            peer.recv(300)


def random_bytes(chance: random.Random, peer: socket.socket) -> None:
    """No frames at all."""
    data = chance.randbytes(chance.randrange(1, 4000))
    if harmless(data[7:]):
        peer.sendall(data)
        peer.recv(300)


def lying_headers(chance: random.Random, peer: socket.socket) -> None:
    """Lengths that are 0, too long, or promise bytes that never come."""
    length = chance.choice([0, 1, 255, 256, 4096, 65535])
    peer.sendall(struct.pack(">HHHB", 1, 0, length, 1) + chance.randbytes(chance.randrange(300)))
    peer.recv(300)


def foreign_protocols(chance: random.Random, peer: socket.socket) -> None:
    """HTTP, TLS, S7, an RTU frame, a wrong protocol number."""
    peer.sendall(
        chance.choice(
            [
                b"GET / HTTP/1.1\r\nHost: cell\r\n\r\n",
                bytes.fromhex("16030100c4010000c00303"),
                bytes.fromhex("0300001611e00000000100c0010ac1020100c2020102"),
                bytes.fromhex("010300000018458f"),
                struct.pack(">HHHB", 1, 7, 6, 1) + read_pdu(3, 0, 24),
            ]
        )
    )
    peer.recv(300)


def cut_frames(chance: random.Random, peer: socket.socket) -> None:
    """Begins, and hangs up or resets in the middle."""
    whole = frame(read_pdu(4, 0, 40))
    peer.sendall(whole[: chance.randrange(1, len(whole))])
    if chance.random() < 0.5:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def floods(chance: random.Random, peer: socket.socket) -> None:
    """Thousands of requests whose answers nobody reads."""
    peer.settimeout(0.2)
    with contextlib.suppress(TimeoutError):
        for _ in range(20):
            peer.sendall(frame(read_pdu(4, 0, 40)) * 500)


def byte_by_byte(chance: random.Random, peer: socket.socket) -> None:
    """A frame with a pause after each byte."""
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for byte in frame(read_pdu(3, 0, 24)):
        peer.sendall(bytes([byte]))
        time.sleep(0.005)
    peer.recv(300)


def connects_only(chance: random.Random, peer: socket.socket) -> None:
    """Says nothing and stays a while."""
    time.sleep(chance.random() * 0.1)


TALKS: tuple[Talk, ...] = (
    random_frames,
    random_bytes,
    lying_headers,
    foreign_protocols,
    cut_frames,
    floods,
    byte_by_byte,
    connects_only,
)


@dataclass(slots=True)
class Noise:
    """Threads that connect to a port and talk nonsense until told to end."""

    port: int
    threads: int
    seed: int
    source: str = "127.0.0.1"
    talks: Counter[str] = field(default_factory=Counter)
    turned_away: int = 0
    _stop: threading.Event = field(default_factory=threading.Event)
    _running: list[threading.Thread] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __enter__(self) -> Noise:
        for number in range(self.threads):
            thread = threading.Thread(target=self._run, args=(number,), name=f"noise-{number}")
            self._running.append(thread)
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._running:
            thread.join(10.0)
            assert not thread.is_alive()

    def _run(self, number: int) -> None:
        chance = random.Random(f"{self.seed} {number}")
        while not self._stop.is_set():
            talk = chance.choice(TALKS)
            try:
                with socket.create_connection(
                    ("127.0.0.1", self.port), timeout=1.0, source_address=(self.source, 0)
                ) as peer:
                    talk(chance, peer)
                with self._lock:
                    self.talks[talk.__name__] += 1
            except OSError:
                with self._lock:
                    self.turned_away += 1
