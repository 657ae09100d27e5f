"""structlog set-up: JSON lines for the service, colours on a terminal. Events are past tense with keys."""

from __future__ import annotations

import sys
from typing import TextIO

import structlog
from structlog.typing import FilteringBoundLogger, Processor


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
        logger_factory=structlog.PrintLoggerFactory(out),
        cache_logger_on_first_use=False,
    )


def logger(part: str) -> FilteringBoundLogger:
    """A logger that says which part of the cell speaks."""
    bound: FilteringBoundLogger = structlog.get_logger(part=part)
    return bound
