"""The detector on a thread of its own: its first certain answer while it explains the rest of the scene.

The only thread that the cell thread starts. It lives as long as one look: whoever opens a `Finding` joins it,
whatever happens, or abandons it, and a run that nobody waits for any more ends at its next stage.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Final, Self

from cell.faults import VisionFailed
from cell.planning import Plan
from drivers.timing import StopToken
from vision.published import Observer
from vision.types import Candidate, Scene

FIRST: Final = "first"
"""The stage whose product is a first answer, a `Scene` that is not complete."""
_POLL_S: Final = 0.02
_MOST_S: Final = 300.0
"""A detector that was never compiled on this machine takes minutes; the service's watchdog is quicker."""
_SAME_MIDDLE_DIAMETERS: Final = 1.5
_SAME_AXIS: Final = 0.99
_BAD_PICTURES: Final = (ValueError, ArithmeticError, IndexError, RuntimeError)


class _Abandoned(Exception):
    """Nobody waits for this run any more; ends it at its next stage."""


class Finding:
    """One run of the detector. Used as a context by one thread, which is the only one to ask it.

    Parameters
    ----------
    find
        The detector, ready but for its observer.
    watch
        Told every stage in the thread of the detector; read it when the whole scene is there.
    """

    def __init__(self, find: Callable[[Observer], Scene], watch: Observer) -> None:
        self._find = find
        self._watch = watch
        self._answers: queue.SimpleQueue[Scene | Exception] = queue.SimpleQueue()
        self._abandoned = threading.Event()
        self._thread = threading.Thread(target=self._run, name="find", daemon=True)
        self._first: Scene | None = None
        self._last: Scene | Exception | None = None

    def start(self) -> None:
        """Search from now on; whoever starts it uses it as a context later, or abandons it."""
        if self._thread.ident is None:
            self._thread.start()

    def abandon(self) -> None:
        """Nobody waits for the answer: end at the next stage, and be joined."""
        self._abandoned.set()
        self._thread.join(_MOST_S)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._abandoned.set()
        self._thread.join(_MOST_S)
        if self._thread.is_alive() and error is None:
            raise VisionFailed(f"the detector did not end within {_MOST_S:.0f} s")

    def first(self, stop: StopToken) -> Scene:
        """The first answer; the whole scene where that comes without one.

        Raises
        ------
        StopRequested, VisionFailed
            Also whatever else the detector raises.
        """
        self._await(lambda: self._first is not None or self._last is not None, stop)
        return self.whole(stop) if self._first is None else self._first

    @property
    def ended(self) -> bool:
        """True when `whole` has not to wait."""
        self._collect(0.0)
        return self._last is not None

    def whole(self, stop: StopToken) -> Scene:
        """The complete scene. Raises as `first`."""
        self._await(lambda: self._last is not None, stop)
        if isinstance(self._last, Scene):
            return self._last
        assert self._last is not None, "awaited"
        if isinstance(self._last, _BAD_PICTURES):
            raise VisionFailed(f"{type(self._last).__name__}: {self._last}") from self._last
        raise self._last

    def _await(self, there: Callable[[], bool], stop: StopToken) -> None:
        waited_s = 0.0
        while not there():
            stop.check()
            if waited_s >= _MOST_S:
                raise VisionFailed(f"the detector gave no answer within {_MOST_S:.0f} s")
            self._collect(_POLL_S)
            waited_s += _POLL_S

    def _collect(self, timeout_s: float) -> None:
        try:
            answer = self._answers.get(timeout=timeout_s) if timeout_s > 0 else self._answers.get_nowait()
            while isinstance(answer, Scene) and not answer.complete:
                self._first = answer if self._first is None else self._first
                answer = self._answers.get_nowait()
        except queue.Empty:
            return
        self._last = answer

    def _run(self) -> None:
        try:
            self._answers.put(self._find(self._tell))
        except Exception as error:  # noqa: BLE001 - handed to the thread that asks, which raises it
            self._answers.put(error)

    def _tell(self, stage: str, product: object) -> None:
        if self._abandoned.is_set():
            raise _Abandoned
        self._watch(stage, product)
        if stage == FIRST and isinstance(product, Scene) and not product.complete:
            self._answers.put(product)


def confirmed(
    early: Candidate, first: Scene, whole: Scene, plans: tuple[Plan, ...], diameter_m: float
) -> Plan | None:
    """The whole scene's plan for a part of the first answer; None where it may not be picked after all.

    It must be offered there too, the jaws must have room and close on nothing else, and nothing may lie over
    it that the first answer did not know of. Only the whole scene can tell where the jaws have room: the
    first answer knows of few of the parts about it.
    """
    again = next(
        (
            plan
            for plan in plans
            if plan.pick is not None
            and plan.pick.gap_free
            and plan.candidate.offered
            and _same(plan.candidate, early, diameter_m)
        ),
        None,
    )
    if again is None or _weighing(whole, again.candidate) > _weighing(first, early):
        return None
    return again


def _same(one: Candidate, other: Candidate, diameter_m: float) -> bool:
    apart = float(sum((one.centre - other.centre) ** 2) ** 0.5)
    return apart < _SAME_MIDDLE_DIAMETERS * diameter_m and abs(float(one.axis @ other.axis)) > _SAME_AXIS


def _weighing(scene: Scene, candidate: Candidate) -> int:
    """How many parts lie over a candidate of a scene."""
    return sum(scene.candidates[crossing.below] is candidate for crossing in scene.crossings)
