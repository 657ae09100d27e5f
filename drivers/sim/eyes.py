"""The two eyes of the simulated cell: both open at one instant, and each may have something wrong with it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.sim.optics import Eye
from drivers.sim.render import Lighting, Renderer
from drivers.sim.world import Snapshot, World
from drivers.timing import Clock
from drivers.types import Pixels

EXPOSURE_KEPT_S = 3.0
"""The second eye may still develop an exposure this old: on a busy machine the first one takes its time."""
EYES = ("left", "right")


class CameraFault:
    """Names of what can be wrong with an eye."""

    NONE = "none"
    FREEZE = "freeze"
    BLACK = "black"
    SATURATE = "saturate"
    SLOW = "slow"
    SILENT = "silent"


@dataclass(slots=True, eq=False)
class _EyeState:
    renderer: Renderer
    lock: threading.Lock
    fault: str = CameraFault.NONE
    slow_s: float = 0.0
    last: Pixels | None = None
    sequence: int = 0
    developed: int = 0  # number of the newest exposure this eye has developed


@dataclass(frozen=True, slots=True, eq=False)
class _Exposure:
    number: int
    snapshot: Snapshot
    captured_at: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shot:
    """One developed picture."""

    pixels: Pixels
    captured_at: float
    sequence: int


class Silent(Exception):
    """This eye does not answer in time."""


class Eyes:
    """Left and right eye on one world.

    Parameters
    ----------
    world, eyes, seed, clock
        What is seen, from where, with which noise, and by which clock.
    lock, present
        The world's lock, and what brings the world to the present instant, which it returns (real time).
    """

    def __init__(
        self,
        world: World,
        eyes: tuple[Eye, Eye],
        seed: int,
        clock: Clock,
        lock: threading.RLock,
        present: Callable[[], float],
    ) -> None:
        self._world = world
        self._clock = clock
        self._lock = lock
        self._present = present
        self._lighting = Lighting(world.layout)
        self._lighting_lock = threading.Lock()
        self._eyes = {
            name: _EyeState(renderer=Renderer(eye, world.layout, seed), lock=threading.Lock())
            for name, eye in zip(EYES, eyes, strict=True)
        }
        self._exposure: _Exposure | None = None

    def grab(self, eye: str, newer_than: float, timeout_s: float) -> Shot:
        """A picture exposed after ``newer_than``; `Silent` when that cannot be had in ``timeout_s``."""
        deadline = self._clock.now() + timeout_s
        state = self._eyes[eye]
        never = threading.Event()
        while self._clock.now() <= newer_than:
            if newer_than >= deadline:
                raise Silent(f"no picture after {newer_than:.3f} within {timeout_s:.3f} s")
            self._clock.wait(never, newer_than - self._clock.now() + 0.001)
        with state.lock:
            if state.fault == CameraFault.SILENT:
                self._clock.wait(never, deadline - self._clock.now())
                raise Silent("the eye is silent")
            exposure = self._expose(state, newer_than)
            if state.fault == CameraFault.SLOW:
                self._clock.wait(never, state.slow_s)
            pixels = self._develop(state, exposure)
            state.sequence += 1
            return Shot(pixels=pixels, captured_at=exposure.captured_at, sequence=state.sequence)

    def _expose(self, state: _EyeState, newer_than: float) -> _Exposure:
        """Both eyes open at one instant: the second one to ask gets the instant of the first."""
        with self._lock:
            now = self._present()
            last = self._exposure
            if (
                last is None
                or last.number <= state.developed
                or last.captured_at <= newer_than
                or now - last.captured_at > EXPOSURE_KEPT_S
            ):
                number = 1 if last is None else last.number + 1
                self._world.exposures += 1
                last = _Exposure(number=number, snapshot=self._world.snapshot(), captured_at=now)
                self._exposure = last
            state.developed = last.number
            return last

    def _develop(self, state: _EyeState, exposure: _Exposure) -> Pixels:
        if state.fault == CameraFault.FREEZE and state.last is not None:
            return state.last
        with self._lighting_lock:
            light = self._lighting.of(exposure.snapshot)
        pixels = state.renderer.picture(exposure.snapshot, light)
        if state.fault == CameraFault.BLACK:
            pixels = (pixels // 64).astype(np.uint8)
        elif state.fault == CameraFault.SATURATE:
            pixels = np.minimum(pixels.astype(np.uint16) * 2 + 190, 255).astype(np.uint8)
        state.last = pixels
        return pixels

    def set_fault(self, eye: str, fault: str, slow_s: float = 0.0) -> None:
        """What is wrong with an eye from now on."""
        with self._lock:
            self._eyes[eye].fault, self._eyes[eye].slow_s = fault, slow_s
