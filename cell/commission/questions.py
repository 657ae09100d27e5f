"""Questions to the person at the keyboard. No answer (end of input) is a no."""

from __future__ import annotations

import sys

from cell.errors import UsageError


def ask(text: str) -> bool:
    """Yes or no; anything but y, yes or nothing at all is a no."""
    return line(f"{text} [Y/n] ").lower() in ("", "y", "yes")


def line(text: str) -> str:
    """One line of the person's.

    Raises
    ------
    UsageError
        The input has ended: nobody is there.
    """
    sys.stdout.write(text)
    sys.stdout.flush()
    answer = sys.stdin.readline()
    if not answer:
        raise UsageError("nobody answers (end of input); give --yes where nothing is to be asked")
    return answer.strip()
