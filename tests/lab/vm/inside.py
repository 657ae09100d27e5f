"""Runs in the virtual machine: the project's own driver on the cameras there; prints one JSON document.

inside.py pictures FOLDER | refusals | life | owned | rate SECONDS | compare SECONDS
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from drivers.camera.life import CameraState, OwnedCamera
from drivers.camera.opencv import OpencvSource
from drivers.camera.source import Source
from drivers.camera.v4l2 import V4l2Source
from drivers.camera.v4l2_list import found
from drivers.camera_settings import V4l2CameraSettings
from drivers.errors import DriverError
from drivers.factory import Factory
from drivers.timing import MonotonicClock
from drivers.types import Frame, Pixels
from tests.lab.vm.numbered import BITS, rows_of_number
from tests.lab.vm.webcam import tell

CLOCK = MonotonicClock()
EYES = ("left", "right")
RATE_S = 6.0
BENCH_S = 10.0
Json = dict[str, object]


def by_path(port: int) -> Path:
    """The stable name of the camera in a socket, counted from 0."""
    return Path(f"/dev/v4l/by-path/platform-vhci_hcd.0-usb-0:{port + 1}:1.0-video-index0")


def settings(port: int, **changed: object) -> V4l2CameraSettings:
    """As a cell would have them."""
    usual: Json = {
        "driver": "v4l2",
        "device": str(by_path(port)),
        "width_px": 640,
        "height_px": 480,
        "exposure_us": 5000,
        "gain": 10,
        "white_balance_k": 5000,
        "focus": 20,
        "power_line_hz": 50,
        "delay_s": 1.0,  # on a busy host the camera itself is slow
        **changed,
    }
    return V4l2CameraSettings.model_validate(usual)


def source(port: int, **changed: object) -> Source:
    """A camera of the configured kind, not started."""
    told = settings(port, **changed)
    name = f"camera.{EYES[port]}"
    return OpencvSource(name, told, CLOCK) if told.capture == "opencv" else V4l2Source(name, told, CLOCK)


def number_of(pixels: Pixels) -> int:
    """The number a camera wrote into its picture; -1 when it cannot be read."""
    wide = pixels.shape[1] // 16
    rows = rows_of_number(pixels.shape[1])
    blocks = pixels[-16 * rows :, : 16 * wide].reshape(rows, 16, wide, 16, -1)[:, 4:12, :, 4:12]
    ones = blocks.mean(axis=(1, 3, 4)).reshape(-1)[: 2 * BITS] > 60.0
    if np.any(ones[:BITS] == ones[BITS:]):
        return -1
    return int(sum(1 << n for n in range(BITS) if ones[n]))


def grab(one: Source, newer_than: float, timeout_s: float) -> Frame:
    """The first frame exposed after an instant."""
    until = time.monotonic() + timeout_s
    while (left_s := until - time.monotonic()) > 0.0:
        frame = one.next(left_s)
        if frame is not None and frame.captured_at > newer_than:
            return frame
    raise TimeoutError(f"{one.name}: no frame in {timeout_s} s")


def pictures(folder: Path) -> Json:
    """Two pairs of both cameras as files; what the devices themselves say of their controls."""
    both = [source(port) for port in (0, 1)]
    told: list[Json] = []
    try:
        for one in both:
            one.start()
        for shot in range(2):
            asked_at = time.monotonic()
            for eye, one in zip(EYES, both, strict=True):
                frame = grab(one, asked_at, 20.0)
                assert cv2.imwrite(str(folder / f"{eye}{shot}.png"), frame.pixels)
                told.append(
                    {
                        "eye": eye,
                        "age_s": frame.captured_at - asked_at,
                        "number": number_of(frame.pixels),
                        "sequence": frame.sequence,
                        "level": float(frame.pixels.mean()),
                    }
                )
        states = [tell("state", port) for port in (0, 1)]
    finally:
        for one in both:
            one.stop()
    return {"frames": told, "controls": [state["controls"] for state in states]}


def levels() -> Json:
    """How bright the picture is at each exposure, once the camera says the control is set."""
    told: Json = {}
    for exposure_us in (2500, 5000, 10000):
        one = source(0, exposure_us=exposure_us)
        try:
            one.start()
            told[str(exposure_us)] = float(grab(one, time.monotonic(), 20.0).pixels[:400].mean())
        finally:
            one.stop()
    one = source(0, format="YUYV", rate_hz=5)
    try:
        one.start()
        told["YUYV"] = float(grab(one, time.monotonic(), 20.0).pixels[:400].mean())
    finally:
        one.stop()
    return told


def refused(change: Callable[[], Source]) -> Json:
    """What a source says that must not start."""
    one = change()
    began = time.monotonic()
    try:
        one.start()
    except DriverError as error:
        return {"kind": type(error).__name__, "says": str(error), "took_s": time.monotonic() - began}
    finally:
        one.stop()
    return {"kind": "none", "says": "", "took_s": time.monotonic() - began}


def refusals() -> Json:
    """Every way a camera can be other than its settings."""
    metadata = str(by_path(0)).replace("index0", "index1")
    told: Json = {
        "size": refused(lambda: source(0, width_px=800, height_px=600)),
        "rate": refused(lambda: source(0, rate_hz=24)),
        "raw rate": refused(lambda: source(0, format="YUYV", rate_hz=30)),
        "grey": refused(lambda: source(0, format="GREY")),
        "gain": refused(lambda: source(0, gain=101)),
        "focus": refused(lambda: source(0, focus=7)),
        "white balance": refused(lambda: source(0, white_balance_k=9000)),
        "absent": refused(lambda: source(0, device="/dev/v4l/by-path/nothing-video-index0")),
        "metadata": refused(lambda: source(0, device=metadata)),
    }
    holder = source(0)
    holder.start()
    try:
        told["busy"] = refused(lambda: source(0))
    finally:
        holder.stop()
    os.seteuid(65534)
    try:
        told["forbidden"] = refused(lambda: source(0))
    finally:
        os.seteuid(0)
    cameras = [{"device": one.device, "also": one.also, "formats": one.formats} for one in found()]
    return {"refused": told, "found": cameras}


def life() -> Json:
    """Freeze, thaw, spoilt pictures, unplug, replug: what the source says and after how long."""
    told: Json = {}
    one = source(0)
    one.start()
    try:
        grab(one, time.monotonic(), 20.0)
        tell("frozen")
        while one.next(0.3) is not None:  # what was under way
            continue
        began = time.monotonic()
        told["silent"] = one.next(0.5) is None
        told["silent_took_s"] = time.monotonic() - began
        thawed_at = number(tell("none"), "at")
        frame = grab(one, thawed_at, 20.0)
        told["thawed_after_s"] = time.monotonic() - thawed_at
        told["thawed_number_known"] = number_of(frame.pixels) > 0
        for fault in ("short", "spoilt"):
            before = one.counters()
            tell(fault)
            time.sleep(1.0)
            while one.next(0.2) is not None:
                continue
            tell("none")
            grab(one, time.monotonic(), 20.0)
            after = one.counters()
            told[fault] = {
                "incomplete": after.incomplete - before.incomplete,
                "dropped": after.dropped - before.dropped,
            }
        pulled_at = number(tell("unplug"), "at")
        try:
            while True:
                one.next(5.0)
        except DriverError as error:
            told["unplugged_after_s"] = time.monotonic() - pulled_at
            told["unplugged"] = {"kind": type(error).__name__, "says": str(error)}
        one.stop()
        told["while_away"] = refused(lambda: source(0))
        plugged_at = number(tell("plug"), "at")
        while True:
            try:
                one.start()
                break
            except DriverError as error:
                told["last_refusal"] = str(error)
                if time.monotonic() > plugged_at + 40.0:
                    raise
                time.sleep(0.1)
        frame = grab(one, time.monotonic(), 20.0)
        told["back_after_s"] = time.monotonic() - plugged_at
        told["back_number"] = number_of(frame.pixels)
        told["back_controls"] = tell("state")["controls"]
    finally:
        one.stop()
    return told


def owned() -> Json:
    """The camera as a cell has it, with its owner thread: lost when it freezes or is pulled out, and back."""
    camera = Factory(CLOCK).camera("camera.left", settings(0, rate_hz=5, lost_s=2.0))
    assert isinstance(camera, OwnedCamera)
    told: Json = {}

    def until(ready: bool, since: float) -> float:
        ends_at = since + 40.0
        while (camera.status().state is CameraState.READY) is not ready:
            assert time.monotonic() < ends_at, camera.status()
            time.sleep(0.01)
        return time.monotonic() - since

    began = time.monotonic()
    camera.open()
    told["open_s"] = time.monotonic() - began
    try:
        for fault, mend in (("frozen", "none"), ("unplug", "plug")):
            before = number_of(camera.grab(newer_than=time.monotonic(), timeout_s=20.0).pixels)
            upset_at = number(tell(fault), "at")
            told[f"{fault}_seen_s"] = until(False, upset_at)
            while camera.status().state not in (CameraState.LOST, CameraState.BACKOFF):
                time.sleep(0.01)
            told[f"{fault}_lost_s"] = time.monotonic() - upset_at
            try:
                camera.grab(newer_than=time.monotonic(), timeout_s=5.0)
            except DriverError as error:
                told[f"{fault}_says"] = f"{type(error).__name__}: {error}"
            mended_at = number(tell(mend), "at")
            told[f"{mend}_ready_s"] = until(True, mended_at)
            after = number_of(camera.grab(newer_than=mended_at, timeout_s=20.0).pixels)
            told[f"{mend}_is_new"] = after > before
        told["losses"] = camera.status().losses
        told["controls"] = tell("state")["controls"]
    finally:
        camera.close()
    return told


def number(answer: Json, key: str) -> float:
    """A number of an answer."""
    value = answer[key]
    assert isinstance(value, int | float)
    return float(value)


def rate(seconds: float, **changed: object) -> Json:
    """Both cameras at once for a while: frames, losses, stale ones, delay and processor time."""
    both = [source(port, **changed) for port in (0, 1)]
    told: list[Json] = [{}, {}]
    used = [0.0, 0.0]
    opened: list[list[float]] = [[], []]

    def watch(port: int) -> None:
        one = both[port]
        clock = time.thread_time()
        ends_at = time.monotonic() + seconds
        seen: list[tuple[int, float, float]] = []
        at_first = one.counters()
        while time.monotonic() < ends_at:
            frame = one.next(1.0)
            if frame is not None:
                seen.append((number_of(frame.pixels), frame.captured_at, time.monotonic()))
                at_first = one.counters() if len(seen) == 1 else at_first
        used[port] = time.thread_time() - clock
        state = tell("state", port)
        exposed = state["begun"]
        assert isinstance(exposed, dict)
        delays = [at - exposed[str(n)] for n, _, at in seen if str(n) in exposed]
        opened[port] = [exposed[str(n)] for n, _, _ in seen if str(n) in exposed]
        early = [exposed[str(n)] - stamp for n, stamp, _ in seen if str(n) in exposed]
        numbers = [n for n, _, _ in seen]
        counted = one.counters()
        told[port] = {
            "frames": counted.frames,
            "dropped_since_first": counted.dropped - at_first.dropped,
            "incomplete_since_first": counted.incomplete - at_first.incomplete,
            "camera_hz": (numbers[-1] - numbers[0]) / (seen[-1][2] - seen[0][2]) if len(seen) > 1 else 0.0,
            "unread": sum(1 for n in numbers if n < 0),
            "repeated": sum(1 for a, b in pairwise(numbers) if b <= a),
            "missing": sum(max(0, b - a - 1) for a, b in pairwise(numbers)),
            "span_s": seen[-1][2] - seen[0][2] if seen else 0.0,
            "delay_median_s": median(delays) if delays else -1.0,
            "delay_p95_s": sorted(delays)[int(0.95 * len(delays))] if delays else -1.0,
            "stamp_after_exposure_s": -min(early) if early else 0.0,
        }

    try:
        for one in both:
            one.start()
        workers = [threading.Thread(target=watch, args=(port,)) for port in (0, 1)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
    finally:
        for one in both:
            one.stop()
    skews = sorted(min(abs(one - other) for other in opened[1]) for one in opened[0] if opened[1])
    return {
        "cameras": told,
        "cpu_percent": 100.0 * sum(used) / seconds,
        "skew_s": [skews[int(share * (len(skews) - 1))] for share in (0.5, 0.95, 1.0)] if skews else [],
    }


def main(argv: list[str]) -> None:
    """Do everything asked for, each to a file ``<name>.json`` in the folder."""
    folder = Path(argv[0])
    for what in argv[1:]:
        match what:
            case "pictures":
                told = pictures(folder)
            case "levels":
                told = levels()
            case "refusals":
                told = refusals()
            case "life":
                told = life()
            case "owned":
                told = owned()
            case "rate":
                told = rate(RATE_S)
            case _:
                # capture:rate, e.g. opencv:15
                capture, rate_hz = what.split(":")
                told = rate(BENCH_S, capture=capture, rate_hz=int(rate_hz))
        (folder / f"{what}.json").write_text(json.dumps(told))


if __name__ == "__main__":
    main(sys.argv[1:])
