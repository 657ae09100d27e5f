"""What `mikado plc verify` tells: each step as it ends, what was found, what to do; latencies at the end."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from rich.console import Console
from rich.markup import escape


class Verdict(Enum):
    """How a step ended; a note is nothing wrong, but something nobody could check."""

    PASS = "pass"
    FAIL = "FAIL"
    NOTE = "note"


_COLOURS = {Verdict.PASS: "green", Verdict.FAIL: "red", Verdict.NOTE: "yellow"}


class Transcript:
    """The lines so far, printed as they come."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._latencies: dict[str, list[float]] = {}
        self.failed: list[str] = []

    def head(self, text: str) -> None:
        """What is going to happen."""
        self._console.print(f"[bold]{escape(text)}[/bold]", highlight=False)

    def step(self, what: str, good: bool, found: str, do: str = "") -> bool:
        """One checked step; returns ``good``."""
        self._line(Verdict.PASS if good else Verdict.FAIL, what, found, do)
        if not good:
            self.failed.append(what)
        return good

    def note(self, what: str, found: str, do: str = "") -> None:
        """Something that could not be checked, or that a person has to compare."""
        self._line(Verdict.NOTE, what, found, do)

    def _line(self, verdict: Verdict, what: str, found: str, do: str) -> None:
        colour = _COLOURS[verdict]
        self._console.print(
            f"  [{colour}]{verdict.value}[/{colour}] {what:<24} {escape(found)}", highlight=False
        )
        if do and verdict is not Verdict.PASS:
            self._console.print(f"       {'':<24} -> {escape(do)}", highlight=False)

    def took(self, what: str, seconds: float) -> None:
        """One more measurement of this kind."""
        self._latencies.setdefault(what, []).append(seconds)

    def end(self) -> int:
        """The latencies and the verdict; the exit code."""
        if self._latencies:
            self._console.print(f"\n  {'latency':<42} {'n':>5} {'p50':>9} {'p99':>9} {'most':>9}")
        for what, seconds in self._latencies.items():
            p50, p99 = quantile(seconds, 0.5), quantile(seconds, 0.99)
            self._console.print(
                f"  {what:<42} {len(seconds):>5} {_ms(p50):>9} {_ms(p99):>9} {_ms(max(seconds)):>9}",
                highlight=False,
            )
        if self.failed:
            self._console.print(f"[red]failed: {escape(', '.join(self.failed))}[/red]", highlight=False)
            return 1
        self._console.print("[green]passed[/green]")
        return 0


def quantile(values: Sequence[float], share: float) -> float:
    """The smallest value that at least this share of them does not exceed.

    >>> quantile([3.0, 1.0, 2.0], 0.5)
    2.0
    """
    ordered = sorted(values)
    return ordered[max(0, -int(-share * len(ordered) // 1) - 1)]


def _ms(seconds: float) -> str:
    return f"{1000 * seconds:.1f} ms"
