"""What passes between threads, and how a thread that fails or stalls is noticed."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from cell.workers import Beat, BeatingClock, Latest, Mailbox, MailboxFull, Worker, WorkerGroup
from drivers.timing import MonotonicClock, StopRequested, StopToken
from tests.fakes.clock import FakeClock


def test_the_latest_value_replaces_the_one_before_and_knows_its_age() -> None:
    clock = FakeClock()
    latest = Latest(1, clock)
    clock.turn(2.0)
    assert (latest.get(), latest.age_s()) == (1, 2.0)
    latest.put(5)
    clock.turn(0.5)
    assert (latest.get(), latest.age_s()) == (5, 0.5)


def test_a_mailbox_gives_in_the_order_it_got() -> None:
    box: Mailbox[int] = Mailbox(3)
    for item in (1, 2, 3):
        box.put(item)
    assert [box.take(0.0) for _ in range(4)] == [1, 2, 3, None]


def test_a_full_mailbox_refuses_and_keeps_what_it_has() -> None:
    box: Mailbox[str] = Mailbox(1)
    box.put("first")
    with pytest.raises(MailboxFull, match="no room for 'second'"):
        box.put("second")
    assert [box.take(0.0), box.take(0.0)] == ["first", None]


def test_a_taker_is_woken_by_an_item_from_another_thread() -> None:
    box: Mailbox[int] = Mailbox(1)
    taken: list[int | None] = []
    taker = threading.Thread(target=lambda: taken.append(box.take(30.0)))
    taker.start()
    box.put(7)
    taker.join(10.0)
    assert taken == [7]


def test_a_beat_is_fresh_until_its_limit() -> None:
    clock = FakeClock()
    beat = Beat("plc", 3.0, clock)
    fresh = []
    for seconds in (3.0, 0.1):
        clock.turn(seconds)
        fresh.append(beat.fresh)
    beat()
    fresh.append(beat.fresh)
    assert fresh == [True, False, True]
    assert beat.age_s() == 0.0


def test_waiting_through_a_beating_clock_is_a_sign_of_life() -> None:
    clock = FakeClock()
    beat = Beat("cell", 1.0, clock)
    token = StopToken(BeatingClock(clock, beat))
    for _ in range(50):  # a motion that is polled for five seconds
        token.wait(0.1)
        assert beat.fresh
    assert clock.now() == pytest.approx(1005.0)


def test_a_token_on_a_beating_clock_still_stops() -> None:
    clock = FakeClock()
    token = StopToken(BeatingClock(clock, Beat("cell", 1.0, clock)))
    clock.at(clock.now() + 0.3, lambda: token.stop("asked"))
    with pytest.raises(StopRequested, match="asked"):
        token.wait(10.0)
    assert clock.now() == pytest.approx(1000.3)


# ------------------------------------------------------------------------------ groups


def worker(name: str, body: Callable[[StopToken], None], limit_s: float = 30.0) -> Worker:
    clock = MonotonicClock()
    stop = StopToken(clock)
    return Worker(name=name, body=lambda: body(stop), stop=stop, beat=Beat(name, limit_s, clock))


def until_stopped(stop: StopToken) -> None:
    stop.wait(60.0)


def ended(group: WorkerGroup) -> tuple[str, BaseException] | None:
    """The first failure, as soon as there is one."""
    token = StopToken(MonotonicClock())
    for _ in range(1000):
        failure = group.failure()
        if failure is not None:
            return failure
        token.wait(0.005)
    return None


def test_a_worker_ends_when_its_token_fires_and_that_is_no_failure() -> None:
    group = WorkerGroup(MonotonicClock())
    group.start(worker("cell", until_stopped))
    assert group.end("cell", "service ends", 10.0)
    assert group.failure() is None


def test_a_worker_that_raises_is_named_with_its_error() -> None:
    def breaks(_: StopToken) -> None:
        raise ValueError("bad")

    group = WorkerGroup(MonotonicClock())
    group.start(worker("cell", breaks))
    failure = ended(group)
    assert failure is not None
    name, error = failure
    assert (name, str(error)) == ("cell", "bad")
    assert group.end("cell", "service ends", 10.0)


def test_a_worker_that_returns_without_being_asked_is_a_failure() -> None:
    group = WorkerGroup(MonotonicClock())
    group.start(worker("plc", lambda _: None))
    failure = ended(group)
    assert failure is not None
    assert failure[0] == "plc"
    assert "without being asked" in str(failure[1])


def test_a_stop_that_came_from_somewhere_else_is_no_way_to_end_a_worker() -> None:
    def stopped_by_a_child(_: StopToken) -> None:
        raise StopRequested("an order's own token leaked")

    group = WorkerGroup(MonotonicClock())
    group.start(worker("cell", stopped_by_a_child))
    assert ended(group) is not None


def test_the_first_failure_is_the_one_that_is_told() -> None:
    first_done = threading.Event()

    def first(_: StopToken) -> None:
        raise ValueError("first")

    def second(_: StopToken) -> None:
        first_done.wait(10.0)
        raise ValueError("second")

    group = WorkerGroup(MonotonicClock())
    group.start(worker("b", second))
    group.start(worker("a", first))
    assert group.end("a", "x", 10.0)
    first_done.set()
    assert group.end("b", "x", 10.0)
    failure = group.failure()
    assert failure is not None
    assert str(failure[1]) == "first"


def test_a_worker_that_makes_no_progress_is_told_by_name_and_one_that_ended_is_not() -> None:
    group = WorkerGroup(MonotonicClock())
    slow = worker("slow", until_stopped, limit_s=-1.0)  # any age is too old
    group.start(slow)
    group.start(worker("gone", lambda _: None, limit_s=-1.0))
    assert group.end("gone", "x", 10.0)
    assert [beat.name for beat in group.stalled()] == ["slow"]
    assert group.end("slow", "x", 10.0)
    assert group.stalled() == []


def test_a_worker_that_does_not_end_in_time_is_said() -> None:
    release = threading.Event()
    group = WorkerGroup(MonotonicClock())
    group.start(worker("deaf", lambda _: (release.wait(30.0), None)[1]))
    assert not group.end("deaf", "service ends", 0.01)
    release.set()
    assert group.end("deaf", "service ends", 10.0)


def test_nobody_can_end_a_worker_that_was_never_started() -> None:
    with pytest.raises(KeyError, match="plc"):
        WorkerGroup(MonotonicClock()).end("plc", "x", 0.1)
