"""GigE Vision cameras: our driver beside Aravis alone and viva-genicam, and how far apart the pairs are.

``python -m bench.gige [--rates 15 30] [--seconds 10] [--pairs 100]`` as root; a part of `bench.cameras`.

Two fake cameras of Aravis, processes in network namespaces of their own (`tests/lab/gige.py`), every picture
with its number and the instant of its exposure in it. Both cameras are read at once, a thread each.
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import structlog

from bench import machine, tables
from drivers.camera import aravis
from drivers.camera.gige import BUFFERS, GigeSource
from drivers.errors import StaleData
from drivers.factory import Factory
from drivers.timing import MonotonicClock
from tests.lab import gige, stamp

COMMAND: Final = "python -m bench.gige"
CLOCK: Final = MonotonicClock()
PICTURES: Final = Path(__file__).parents[1] / "tests" / "data"
EXPOSURE_US: Final = 5000.0
WAIT_S: Final = 2.0
PACKET_SIZE: Final = 8000
SKEW_S: Final = 0.04
"""`cameras.max_skew_s` of the pairs."""
STILL_S: Final = 5.0

Strip = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True)
class Came:
    """A picture in hand: the rows with its stamp, and when it was there as pixels."""

    strip: Strip
    at: float


class NoCameras(Exception):
    """What this machine lacks for them."""


class Reader:
    """One camera, by one of the ways; used by one thread. ``next`` gives pixels, None when none came."""

    def __init__(self, next_pixels: Callable[[], npt.NDArray[np.uint8] | None], lost: Callable[[], int]):
        self._next = next_pixels
        self.lost = lost

    def next(self) -> Came | None:
        pixels = self._next()
        at = time.monotonic()
        return None if pixels is None else Came(strip=pixels[-stamp.BLOCK_PX :].copy(), at=at)


@contextmanager
def by_our_driver(eye: str, rate_hz: float) -> Iterator[Reader]:
    """Everything set, read back and checked at each frame."""
    wanted = gige.settings(eye, rate_hz=rate_hz, packet_size=PACKET_SIZE, exposure_us=EXPOSURE_US)
    source = GigeSource(f"camera.{eye}", wanted, CLOCK)

    def pixels() -> npt.NDArray[np.uint8] | None:
        frame = source.next(WAIT_S)
        return None if frame is None else frame.pixels

    source.start()
    try:
        yield Reader(pixels, lambda: source.counters().dropped + source.counters().incomplete)
    finally:
        source.stop()


@contextmanager
def by_aravis(eye: str, rate_hz: float) -> Iterator[Reader]:
    """The shortest program that gets frames."""
    library = aravis.load(f"camera.{eye}")
    camera: Any = library.camera(gige.ADDRESSES[eye])
    camera.set_region(0, 0, 640, 480)
    camera.set_exposure_time(EXPOSURE_US)
    camera.set_frame_rate(rate_hz)
    camera.gv_set_packet_size(PACKET_SIZE)
    stream: Any = library.stream(camera)
    for _ in range(BUFFERS):
        stream.push_buffer(library.buffer(camera.get_payload()))

    def pixels() -> npt.NDArray[np.uint8] | None:
        buffer = stream.timeout_pop_buffer(int(WAIT_S * 1e6))
        if buffer is None:
            return None
        data = buffer.get_image_data()
        stream.push_buffer(buffer)
        return np.frombuffer(data, np.uint8).reshape(480, 640)

    camera.start_acquisition()
    try:
        yield Reader(pixels, lambda: -1)
    finally:
        camera.stop_acquisition()
        library.leave(camera)


@contextmanager
def by_viva(eye: str, rate_hz: float) -> Iterator[Reader]:
    """viva-genicam: no Aravis and no Debian packages."""
    import viva_genicam

    found = [one for one in viva_genicam.discover(1000) if one.ip == gige.ADDRESSES[eye]]
    with viva_genicam.connect_gige(found[0]) as camera:
        camera.set_integer("Width", 640)
        camera.set_integer("Height", 480)
        camera.set_float("ExposureTimeAbs", EXPOSURE_US)
        camera.set_float("AcquisitionFrameRate", rate_hz)
        with camera.stream(packet_size=PACKET_SIZE) as stream:

            def pixels() -> npt.NDArray[np.uint8] | None:
                frame = stream.next_frame(int(1e3 * WAIT_S))
                return None if frame is None else np.asarray(frame.to_numpy(), np.uint8)

            yield Reader(pixels, lambda: int(stream.stats().frames_lost))


WAYS: Final = (
    ("our driver", by_our_driver),
    ("Aravis alone", by_aravis),
    ("viva-genicam", by_viva),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """One camera by one way. ``counted``: what it says it lost, -1: it does not say."""

    hz: float
    delay_ms: tuple[float, float]
    missing: int
    unread: int
    counted: int


def read_both(way: Callable[[str, float], Any], rate_hz: float, seconds: float) -> tuple[list[Told], float]:
    """Both cameras at once for a while; and percent of a core this process used, its libraries included."""
    told: dict[str, Told] = {}
    with way("left", rate_hz) as left, way("right", rate_hz) as right:
        ends_at = time.monotonic() + seconds
        threads = [
            threading.Thread(target=_watch, args=(eye, reader, ends_at, told))
            for eye, reader in (("left", left), ("right", right))
        ]
        began_at, used_s = time.monotonic(), time.process_time()
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        cpu = (time.process_time() - used_s) / (time.monotonic() - began_at)
    return [told[eye] for eye in gige.EYES], 100.0 * cpu


def _watch(eye: str, reader: Reader, ends_at: float, told: dict[str, Told]) -> None:
    came: list[Came] = []
    lost_before = reader.lost()
    while time.monotonic() < ends_at:
        one = reader.next()
        if one is not None:
            came.append(one)
    counted = reader.lost() - lost_before if lost_before >= 0 else -1
    stamps = [(stamp.read(one.strip), one.at) for one in came]
    known = [(mark.number, at - mark.exposed_at) for mark, at in stamps if mark is not None]
    delays = np.array([delay for _, delay in known])
    span_s = came[-1].at - came[0].at if len(came) > 1 else float("nan")
    told[eye] = Told(
        hz=(len(came) - 1) / span_s,
        delay_ms=(1e3 * float(np.median(delays)), 1e3 * float(np.percentile(delays, 95))),
        missing=sum(max(0, b - a - 1) for (a, _), (b, _) in pairwise(known)),
        unread=len(came) - len(known),
        counted=counted,
    )


def ways_sheet(rates_hz: tuple[int, ...], seconds: float) -> tables.Sheet:
    """All ways at all rates, one after the other."""
    rows = []
    for rate_hz in rates_hz:
        for name, way in WAYS:
            if way is by_viva and importlib.util.find_spec("viva_genicam") is None:
                continue
            both, cpu = read_both(way, rate_hz, seconds)
            for eye, one in zip(gige.EYES, both, strict=True):
                rows.append(
                    (
                        *(name, f"{rate_hz}", eye, f"{one.hz:.1f}"),
                        *(tables.milliseconds(ms) for ms in one.delay_ms),
                        *(f"{one.missing}", f"{one.unread}", "-" if one.counted < 0 else f"{one.counted}"),
                        f"{cpu:.1f}",
                    )
                )
    return tables.Sheet(
        title="Two GigE Vision cameras at once, Mono8 640x480, over network namespaces of one machine",
        command=COMMAND,
        headings=(
            *("way", "Hz set", "camera", "Hz got", "delay ms", "p95 ms"),
            *("missing", "spoilt", "counted", "CPU % (both)"),
        ),
        rows=tuple(rows),
        notes=(
            "delay: from the exposure, as it stands in the picture, to pixels in hand; missing: numbers that "
            "never came; spoilt: handed out with a broken stamp; counted: what the way itself says it lost. "
            "CPU: of this process, threads of the libraries included.",
            f"host: {machine.processor()}, load {machine.load()}.",
        ),
    )


def skews(pairs: int, **changes: object) -> tuple[list[float], list[float], int]:
    """True skews (s) of pairs by the stamps in their pictures, the stated ones, and how many were refused."""
    left, right = (gige.settings(eye, packet_size=PACKET_SIZE, **changes) for eye in gige.EYES)
    rig = Factory(CLOCK).rig(left, right, SKEW_S)
    true: list[float] = []
    stated: list[float] = []
    refused = 0
    rig.open()
    try:
        while len(true) + refused < pairs:
            try:
                pair = rig.grab_pair(newer_than=CLOCK.now(), timeout_s=STILL_S)
            except StaleData:
                refused += 1
                continue
            marks = [stamp.read(frame.pixels) for frame in (pair.left, pair.right)]
            if marks[0] is not None and marks[1] is not None:
                true.append(abs(marks[0].exposed_at - marks[1].exposed_at))
                stated.append(pair.skew_s)
    finally:
        rig.close()
    return true, stated, refused


def skew_sheet(rates_hz: tuple[int, ...], pairs: int) -> tables.Sheet:
    """How far apart the two pictures of a pair are, by what they show and by what the driver states."""
    rows = []
    kinds: list[tuple[str, dict[str, object]]] = [
        (f"free run, {rate_hz} Hz", {"trigger": "free", "rate_hz": rate_hz}) for rate_hz in rates_hz
    ]
    kinds.append(("triggered by software", {"trigger": "software"}))
    for name, changes in kinds:
        true, stated, refused = skews(pairs, **changes)
        ms = 1e3 * np.percentile(true, (50, 95, 100))
        rows.append(
            (
                *(name, f"{len(true)}", f"{refused}"),
                *(tables.milliseconds(float(one)) for one in ms),
                *(tables.milliseconds(float(one)) for one in 1e3 * np.percentile(stated, (50, 95))),
            )
        )
    return tables.Sheet(
        title=f"Skew of pairs, {1e3 * SKEW_S:.0f} ms allowed",
        command=COMMAND,
        headings=("cameras", "pairs", "refused", "p50 ms", "p95 ms", "max ms", "stated p50", "stated p95"),
        rows=tuple(rows),
        notes=(
            "p50, p95, max: between the two exposures, as they stand in the pictures; stated: by the frames' "
            "own times, on which the limit works. Fake cameras that run freely expose at whole multiples of "
            "their period by one clock, so they are in step; real ones are up to half a period apart. A fake "
            "one looks for a trigger every 10 ms or so, a real one at once.",
        ),
    )


def sheets(rates_hz: tuple[int, ...], seconds: float, pairs: int) -> list[tables.Sheet]:
    """Everything, against cameras started for it.

    Raises
    ------
    NoCameras
        There can be none here; says why.
    """
    lack = gige.missing()
    if lack is not None:
        raise NoCameras(lack)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    left, right = (("--picture", str(PICTURES / f"{eye}.png")) for eye in gige.EYES)
    with gige.network() as net, gige.peers(net, left, right):
        return [ways_sheet(rates_hz, seconds), skew_sheet(rates_hz, pairs)]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog=COMMAND)
    parser.add_argument("--rates", type=int, nargs="+", default=[15, 30], metavar="HZ")
    parser.add_argument("--seconds", type=float, default=10.0, help="for each way and rate")
    parser.add_argument("--pairs", type=int, default=100)
    arguments = parser.parse_args()
    try:
        for sheet in sheets(tuple(arguments.rates), arguments.seconds, arguments.pairs):
            tables.show(sheet)
    except NoCameras as reason:
        raise SystemExit(f"no GigE Vision cameras: {reason}") from reason


if __name__ == "__main__":
    main()
