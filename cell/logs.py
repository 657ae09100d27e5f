"""structlog set-up: JSON lines for the service, colours on a terminal. Events are past tense with keys."""

from __future__ import annotations

import io
import json
import sys
from typing import TextIO, cast

import structlog
from structlog.typing import FilteringBoundLogger, Processor


class _Lossy(io.TextIOBase):
    """A stream that loses lines rather than end the daemon when they cannot be written, and says so later."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lost = 0

    def write(self, text: str) -> int:
        """Write, or count what is lost."""
        try:
            if self._lost:
                self._stream.write(json.dumps({"event": "log_writes_lost", "count": self._lost}) + "\n")
                self._lost = 0
            return self._stream.write(text)
        except OSError:
            self._lost += 1
            return len(text)

    def flush(self) -> None:
        """Pass on what is buffered; what cannot be passed on is lost."""
        try:
            self._stream.flush()
        except OSError:
            self._lost += 1


def setup(stream: TextIO | None = None, *, as_json: bool | None = None) -> None:
    """Configure logging once per process; JSON unless the stream is a terminal."""
    out = stream if stream is not None else sys.stderr
    plain = not out.isatty() if as_json is None else as_json
    renderer: Processor = (
        structlog.processors.JSONRenderer() if plain else structlog.dev.ConsoleRenderer(colors=True)
    )
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info if plain else structlog.processors.StackInfoRenderer(),
            renderer,
        ],
        logger_factory=structlog.PrintLoggerFactory(cast(TextIO, _Lossy(out))),
        cache_logger_on_first_use=False,
    )


def logger(part: str) -> FilteringBoundLogger:
    """A logger that says which part of the cell speaks."""
    bound: FilteringBoundLogger = structlog.get_logger(part=part)
    return bound
