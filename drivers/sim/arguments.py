"""Command lines of the simulated devices: numbers are checked, and what is wrong goes on one line."""

from __future__ import annotations

import argparse
import math
import socket
from typing import Final, NoReturn

EXIT_USAGE: Final = 2


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_USAGE, f"{self.prog}: {message}; see {self.prog} --help\n")


def port(text: str) -> int:
    """A TCP port; 0 stands for any free one."""
    return _whole(text, 0, 65535, "a port (0 to 65535)")


def word(text: str) -> int:
    """What fits a register."""
    return _whole(text, 0, 65535, "a whole number from 0 to 65535")


def count(text: str) -> int:
    """How many."""
    return _whole(text, 0, 1000, "a whole number from 0 to 1000")


def _whole(text: str, low: int, high: int, what: str) -> int:
    if not text.isdecimal() or not low <= int(text) <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
    return int(text)


def positive(text: str) -> float:
    """A finite number above 0."""
    value = _number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above 0")
    return value


def not_negative(text: str) -> float:
    """A finite number, 0 or more."""
    value = _number(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is below 0")
    return value


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


def refusal(host: str, number: int) -> str | None:
    """Why nobody can listen on this address, in the system's words; None when it is free now."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except OSError as error:
        why = f"cannot listen on {host}:{number}: {error.strerror}"
        return f"{why}; choose another --host or --port (0: any free one)"
    return None
