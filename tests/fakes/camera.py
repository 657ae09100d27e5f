"""A scripted camera: this call, this answer, this fault."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drivers.errors import DeviceTimeout, DeviceUnavailable
from drivers.timing import Clock
from drivers.types import Frame, Pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class Grab:
    """One call of `FakeCamera.grab`."""

    newer_than: float
    timeout_s: float


class FakeCamera:
    """Plays ``answers`` one after another: pixels, a whole frame, or an exception.

    Pixels become a frame exposed ``age_s`` ago. A frame not newer than asked for is withheld, as it must be.
    With no answer left it times out.
    """

    def __init__(
        self,
        name: str,
        clock: Clock,
        answers: Iterable[Pixels | Frame | Exception] = (),
        *,
        age_s: float = 0.0,
    ) -> None:
        self._name = name
        self._clock = clock
        self.answers: list[Pixels | Frame | Exception] = list(answers)
        self.open_error: Exception | None = None
        self.age_s = age_s
        self.lost: str | None = None
        self.calls: list[Grab] = []
        self.opened = 0
        self.closed = 0
        self._open = False
        self._sequence = 0

    @property
    def name(self) -> str:
        return self._name

    def open(self) -> None:
        self.opened += 1
        if self.open_error is not None:
            raise self.open_error
        self._open = True

    def close(self) -> None:
        self.closed += 1
        self._open = False

    def check(self) -> None:
        if not self._open:
            raise DeviceUnavailable(self._name, "not open")
        if self.lost is not None:
            raise DeviceUnavailable(self._name, self.lost)

    def grab(self, *, newer_than: float, timeout_s: float) -> Frame:
        self.calls.append(Grab(newer_than=newer_than, timeout_s=timeout_s))
        if not self._open:
            raise DeviceUnavailable(self._name, "not open")
        if not self.answers:
            raise DeviceTimeout(self._name, "the script has no further picture")
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        if isinstance(answer, np.ndarray):
            self._sequence += 1
            pixels = answer.copy()
            pixels.setflags(write=False)
            answer = Frame(
                camera=self._name,
                pixels=pixels,
                captured_at=self._clock.now() - self.age_s,
                sequence=self._sequence,
            )
        if answer.captured_at <= newer_than:
            raise DeviceTimeout(self._name, "only an old picture came")
        return answer
