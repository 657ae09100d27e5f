"""What a measurement was taken on: processor, load, versions, day, state of the code."""

from __future__ import annotations

import os
import platform
import subprocess
import threading
import time
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "scikit-image", "mahotas", "skan", "sknw")


def worked_ms() -> float:
    """Processor time this process has used, all threads together, ms.

    Differences of it are what the benches call ms: on a machine of one's own the wall clock shows no more,
    and on a shared one it does not count the time of others.
    """
    return 1000.0 * time.process_time()


class ProcessorClock:
    """A `drivers.timing.Clock` that counts this process's own work only."""

    def now(self) -> float:
        return time.process_time()

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        return event.wait(max(0.0, timeout_s))


def processor() -> str:
    """The processor's name as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def load() -> str:
    """Load averages of 1, 5 and 15 minutes; above the number of cores, times mean little."""
    return " / ".join(f"{value:.1f}" for value in os.getloadavg())


def version(library: str) -> str:
    """Of an installed distribution, or ``-``."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "-"


def code() -> str:
    """The commit that was measured, and whether files differ from it."""
    root = Path(__file__).parents[1]

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", *words], cwd=root, check=True, capture_output=True, text=True, timeout=20
        ).stdout.strip()

    try:
        changed = git(
            "status", "--porcelain", "--untracked-files=no", "--", "vision", "bench", "cell", "drivers"
        )
        return git("rev-parse", "--short=10", "HEAD") + (" with changes" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def facts(load_before: str) -> tuple[tuple[str, str], ...]:
    """Pairs of what and which."""
    return (
        ("day", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")),
        ("code", code()),
        ("processor", f"{processor()}, {len(os.sched_getaffinity(0))} cores for us of {os.cpu_count()}"),
        ("load (1, 5, 15 minutes)", f"{load_before} before, {load()} after"),
        ("Python", platform.python_version()),
        *((library, version(library)) for library in LIBRARIES),
    )
