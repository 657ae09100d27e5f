"""A scripted gripper: what each grasp gets is written down beforehand."""

from __future__ import annotations

from collections.abc import Iterable

from drivers.errors import DeviceUnavailable
from drivers.timing import StopToken
from drivers.types import Grip


class FakeGripper:
    """Plays ``grasps`` one after another, a grip or an exception; with none left it holds something.

    Set ``held`` between two calls to let a part slip. Closing and opening take ``jaws_s`` on the token's
    clock.
    """

    def __init__(self, name: str, grasps: Iterable[Grip | Exception] = (), *, jaws_s: float = 0.05) -> None:
        self._name = name
        self.grasps: list[Grip | Exception] = list(grasps)
        self.release_error: Exception | None = None
        self.open_error: Exception | None = None
        self.jaws_s = jaws_s
        self.held = Grip.OPEN
        self.calls: list[str] = []
        self.opened = 0
        self.closed = 0
        self._open = False

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

    def _need_open(self) -> None:
        if not self._open:
            raise DeviceUnavailable(self._name, "not open")

    def release(self, *, stop: StopToken) -> None:
        self._need_open()
        self.calls.append("release")
        stop.check()
        if self.release_error is not None:
            raise self.release_error
        self.held = Grip.UNKNOWN
        stop.wait(self.jaws_s)
        self.held = Grip.OPEN

    def grasp(self, *, stop: StopToken) -> Grip:
        self._need_open()
        self.calls.append("grasp")
        stop.check()
        answer = self.grasps.pop(0) if self.grasps else Grip.HOLDING
        if isinstance(answer, Exception):
            raise answer
        self.held = Grip.UNKNOWN
        stop.wait(self.jaws_s)
        self.held = answer
        return answer

    def grip(self) -> Grip:
        self._need_open()
        return self.held
