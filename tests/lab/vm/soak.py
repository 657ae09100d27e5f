"""Runs in the virtual machine: both cameras at 30 Hz for a long time, with their owners, as a cell has them.

soak.py FOLDER SECONDS: what came of it goes to ``soak.json`` in the folder, meanwhile what was seen so far to
``soak-so-far.json``.

Every frame's number is read from its pixels. When the camera exposed that number it says itself, asked every
20 s for all of them. Cameras are frozen for a moment at the beginning and at the end: then nothing is under
way, and what the driver counted can be set against the numbers exactly.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.camera.life import OwnedCamera
from drivers.camera_settings import V4l2CameraSettings
from drivers.factory import Factory
from drivers.types import Frame
from tests.lab.vm.inside import CLOCK, EYES, Json, number, number_of, settings
from tests.lab.vm.numbered import SMALL
from tests.lab.vm.webcam import tell

RATE_HZ = 30
DELAY_S = 0.1
"""How long after its exposure a picture's first bytes may come: the cameras are emulated as well."""
LOST_S = 3.0
PERIOD_S = 20.0
WARM = 0.25
"""This share of the time passes before the first sample of memory counts."""
STILL_S = 0.5
BINS = 20_000
"""Ages are kept in steps of 0.1 ms up to 2 s, so that this program itself does not grow."""


@dataclass(slots=True)
class Seen:
    """What one camera handed out."""

    frames: int = 0
    number: int = -1
    newest: float = float("-inf")
    ahead: int = 0
    unread: int = 0
    repeated: int = 0
    slipped: int = 0
    unknown: int = 0
    too_new: int = 0
    oldest_s: float = 0.0
    stamp_late_s: float = 0.0
    waiting: list[tuple[int, float, float]] = field(default_factory=list)
    under_way: dict[int, float] = field(default_factory=dict)
    ages: np.ndarray[tuple[int], np.dtype[np.int64]] = field(default_factory=lambda: np.zeros(BINS, np.int64))

    def take(self, frame: Frame, seen_at: float) -> None:
        """Read a frame's number and compare with the one before."""
        shown = number_of(frame.pixels)
        self.newest = frame.captured_at
        self.frames += 1
        if shown < 0:
            self.unread += 1
            return
        self.repeated += shown <= self.number
        # the kernel counts the camera's pictures as the camera does, those that it loses too
        self.slipped += frame.sequence - shown != self.ahead
        self.number = shown
        self.waiting.append((shown, frame.captured_at, seen_at))

    def judge(self, exposed: dict[int, float], worst_delay_s: float) -> None:
        """Set what came against the instants at which the camera exposed it. A picture on its way when the
        camera was asked is told of now and comes later."""
        self.under_way.update(exposed)
        for shown, captured_at, seen_at in self.waiting:
            at = self.under_way.get(shown)
            if at is None:
                self.unknown += 1
                continue
            self.too_new += captured_at > at
            self.stamp_late_s = max(self.stamp_late_s, captured_at + worst_delay_s - at)
            self.oldest_s = max(self.oldest_s, seen_at - at)
            self.ages[min(BINS - 1, int((seen_at - at) * 1e4))] += 1
        self.waiting.clear()
        self.under_way = {shown: at for shown, at in self.under_way.items() if shown > self.number}

    def age_s(self, share: float) -> float:
        """This share of the frames was at most so old when handed over."""
        return float(np.searchsorted(np.cumsum(self.ages), share * self.ages.sum()) + 1) * 1e-4

    def told(self) -> Json:
        """Figures of what was handed out."""
        return {
            "handed_over": self.frames,
            "unread": self.unread,
            "repeated": self.repeated,
            "slipped": self.slipped,
            "unknown": self.unknown,
            "too_new": self.too_new,
            "age_median_s": self.age_s(0.5),
            "age_99_s": self.age_s(0.99),
            "age_largest_s": self.oldest_s,
            "stamp_latest_s": self.stamp_late_s,
        }


@dataclass(frozen=True, slots=True)
class Size:
    """Of this process."""

    memory_mb: float
    files: int
    threads: int


def size() -> Size:
    """As it is now."""
    status = Path("/proc/self/status").read_text().splitlines()
    resident = next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))
    return Size(resident / 1024.0, len(list(Path("/proc/self/fd").iterdir())), threading.active_count())


def told_sizes(sizes: list[Size]) -> Json:
    """One list of each figure, in the order of time."""
    return {
        "memory_mb": [one.memory_mb for one in sizes],
        "files": [one.files for one in sizes],
        "threads": [one.threads for one in sizes],
    }


def exposed_since(port: int) -> tuple[dict[int, float], int]:
    """When the pictures since the last such question were exposed; how many the camera sent in all."""
    answer = tell("exposed", port)
    begun = answer["begun"]
    assert isinstance(begun, dict)
    return {int(shown): float(at) for shown, at in begun.items()}, int(number(answer, "sent"))


def opened() -> tuple[list[V4l2CameraSettings], list[OwnedCamera]]:
    """Both cameras, ready."""
    width_px, height_px = SMALL
    usual: Json = {
        "rate_hz": RATE_HZ,
        "width_px": width_px,
        "height_px": height_px,
        "delay_s": DELAY_S,
        "lost_s": LOST_S,
    }
    told = [settings(port, **usual) for port in (0, 1)]
    cameras: list[OwnedCamera] = []
    for eye, setting in zip(EYES, told, strict=True):
        camera = Factory(CLOCK).camera(f"camera.{eye}", setting)
        assert isinstance(camera, OwnedCamera)
        camera.open()
        cameras.append(camera)
    return told, cameras


def standstill(cameras: list[OwnedCamera]) -> list[tuple[Frame, int]]:
    """Freeze the cameras; of each its last frame and how many pictures its driver has accounted for."""
    for port in range(len(cameras)):
        tell("frozen", port)
    counted = [camera.status().counters for camera in cameras]
    still_since = time.monotonic()
    while time.monotonic() < still_since + STILL_S:
        time.sleep(0.05)
        now = [camera.status().counters for camera in cameras]
        if now != counted:
            counted, still_since = now, time.monotonic()
    return [
        (camera.grab(newer_than=float("-inf"), timeout_s=1.0), had.frames + had.dropped + had.incomplete)
        for camera, had in zip(cameras, counted, strict=True)
    ]


def soak(folder: Path, seconds: float) -> Json:
    """Both cameras for that long."""
    told, cameras = opened()
    seen = [Seen(), Seen()]
    sizes: list[Size] = []
    try:
        first = standstill(cameras)
        before = [camera.status().counters for camera in cameras]
        for port, (frame, _) in enumerate(first):
            seen[port].number = number_of(frame.pixels)
            seen[port].newest = frame.captured_at
            seen[port].ahead = frame.sequence - seen[port].number
            exposed_since(port)
            tell("none", port)
        began_at, cpu_at = time.monotonic(), time.process_time()
        warm_at = began_at + WARM * seconds
        # a camera remembers 3000 exposures, 100 s: it is asked from the beginning on
        every_s = min(PERIOD_S, WARM * seconds)
        look_at = began_at + every_s
        while (now := time.monotonic()) < began_at + seconds:
            for one, camera in zip(seen, cameras, strict=True):
                frame = camera.grab(newer_than=one.newest, timeout_s=5.0)
                one.take(frame, time.monotonic())
            if now >= look_at:
                for port, one in enumerate(seen):
                    one.judge(exposed_since(port)[0], told[port].worst_delay_s)
                if now >= warm_at:
                    sizes.append(size())
                so_far = {"cameras": [one.told() for one in seen], "s": now - began_at, **told_sizes(sizes)}
                (folder / "soak-so-far.json").write_text(json.dumps(so_far))
                look_at = now + every_s
        took_s = time.monotonic() - began_at
        cpu = (time.process_time() - cpu_at) / took_s
        last = standstill(cameras)
        sizes.append(size())
        found: list[Json] = []
        for port, one in enumerate(seen):
            exposed, sent = exposed_since(port)
            one.judge(exposed, told[port].worst_delay_s)
            (start, had), (end, has) = first[port], last[port]
            counters, earlier = cameras[port].status().counters, before[port]
            found.append(
                {
                    **one.told(),
                    "frames": counters.frames - earlier.frames,
                    "dropped": counters.dropped - earlier.dropped,
                    "incomplete": counters.incomplete - earlier.incomplete,
                    "accounted_for": has - had,
                    "exposed": number_of(end.pixels) - number_of(start.pixels),
                    "sent_after_last": sent - number_of(end.pixels),
                    "losses": cameras[port].status().losses,
                }
            )
    finally:
        for camera in cameras:
            camera.close()
    return {
        "cameras": found,
        "took_s": took_s,
        "cpu": cpu,
        **told_sizes(sizes),
    }


if __name__ == "__main__":
    where = Path(sys.argv[1])
    (where / "soak.json").write_text(json.dumps(soak(where, float(sys.argv[2]))))
