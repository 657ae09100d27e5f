"""Bad nights: PLC restarts, pulled cables, torn writes, numbers twice and left out, lost cameras, safety
stops, dropped parts, a daemon that is killed, a disk that is full. Every order has ended in exactly one
result, none was carried out twice, nothing moved without one, and nothing was left behind.

Short among the other tests; ``make chaos PICKS=2000`` asks for long nights, two cells side by side.
"""

from __future__ import annotations

import random
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from drivers.types import ResultCode
from tests.lab.chaos import Fault, Night, night
from tests.lab.chaos_faults import FAULTS
from tests.lab.test_soak import zombies_of
from tests.system.processes import until

SHORT = 25
LANES = 2
CALM = 0.9
"""Share of the orders of a long night in which nothing happens."""
MOST_MOTIONS = 16
"""One attempt: out of the way, over, down, up, to the box; with a part left in the hand before it."""
MOST_FILES = 4
MOST_THREADS = 2
MOST_MEMORY_MB = 40.0
LONG_LIFE = 30
"""Orders a daemon must have lived through for its growth to say something."""


@pytest.fixture
def chaos_picks(pytestconfig: pytest.Config) -> int:
    asked: int | None = pytestconfig.getoption("--picks")
    return SHORT if asked is None else asked


def plan(rng: random.Random, orders: int) -> list[Fault | None]:
    """Each fault once, shuffled, in a short night; in a long one they come as they come."""
    if orders <= 2 * len(FAULTS):
        chosen: list[Fault | None] = [*FAULTS[:orders]]
        chosen += [None] * (orders - len(chosen))
        rng.shuffle(chosen)
        return chosen
    return [rng.choice(FAULTS) if rng.random() > CALM else None for _ in range(orders)]


def lane(folder: Path, seed: int, orders: int) -> Night:
    """One night of one cell."""
    folder.mkdir()
    with night(folder, seed) as bad:
        for number, fault in enumerate(plan(bad.rng, orders)):
            bad.order(fault)
            bad.sampled(number)
        bad.recover()
        bad.nothing_moved("at the end")
        with bad.plc.program.lock:
            bad.observer.strange += bad.plc.program.violations
        bad.balance = balance(bad)
        until(lambda: zombies_of(bad.daemon.pid) == 0, 2.0, "no child is left unwaited for")
        code, _ = bad.daemon.terminate()
        assert code == 0
    return bad


def balance(bad: Night) -> dict[str, int]:
    """Where the world says that all the parts are."""
    status = bad.cell.ask("status")
    return {
        "thrown in": bad.added,
        "in tray": status.whole("in_tray"),
        "in hand": int(status.flag("holding")),
        "in box": status.whole("in_box"),
        "lost": status.whole("lost"),
    }


def test_a_bad_night_leaves_every_order_with_one_result(tmp_path: Path, chaos_picks: int) -> None:
    seed = random.SystemRandom().randrange(10**6)
    lanes = 1 if chaos_picks <= 2 * SHORT else LANES
    print(f"\nseed {seed}, {chaos_picks} picks, {lanes} cell(s)")
    began_at = time.monotonic()
    with ThreadPoolExecutor(lanes, thread_name_prefix="night") as pool:
        nights = list(
            pool.map(lambda n: lane(tmp_path / f"lane-{n}", seed + n, chaos_picks // lanes), range(lanes))
        )
    told(nights, time.monotonic() - began_at)
    for bad in nights:
        judge(bad, seed)


def judge(bad: Night, seed: int) -> None:
    where = f"seed {seed}"
    assert bad.observer.strange == [], where
    for order in bad.observer.orders.values():
        ended = len(order.codes) + (order.refused != 0)
        assert ended == 1, f"{where}: {order}"
        # every order asks for one attempt: one closing of the jaws, one part, and what the hand held before
        assert order.grasps <= 1, f"{where}: carried out twice: {order}"
        assert order.boxed <= 1 + order.held_before, f"{where}: carried out twice: {order}"
        assert order.motions <= MOST_MOTIONS, f"{where}: {order}"
    # between `ready` and the order the cell may come to stand, by what the order before left behind, or
    # because on a busy machine the simulated arm or a camera is late; then it shows a fault
    surprised = [order for order in bad.observer.orders.values() if order.refused and not order.fault]
    assert all(o.refused == ResultCode.ROBOT_NOT_READY and o.fault_code for o in surprised), (
        f"{where}: {surprised}"
    )
    b = bad.balance
    assert b["in tray"] + b["in hand"] + b["in box"] + b["lost"] == b["thrown in"], f"{where}: {b}"
    good = bad.results[ResultCode.OK.name]
    cut_short = sum(n for name, n in bad.results.items() if name != ResultCode.OK.name)
    assert good <= b["in box"] + b["lost"] <= good + cut_short, f"{where}: {good} OK, {b}"
    assert bad.faults["daemon ended by itself"] == 0, where
    for life in bad.samples:
        if len(life) >= LONG_LIFE:
            first, last = life[len(life) // 4], life[-1]
            assert last.files <= first.files + MOST_FILES, f"{where}: {first} {last}"
            assert last.threads <= first.threads + MOST_THREADS, f"{where}: {first} {last}"
            assert last.memory_mb <= first.memory_mb + MOST_MEMORY_MB, f"{where}: {first} {last}"


def told(nights: list[Night], took_s: float) -> None:
    """The table, for who runs it with ``-s``."""
    faults: Counter[str] = sum((n.faults for n in nights), Counter())
    results: Counter[str] = sum((n.results for n in nights), Counter())
    codes: Counter[int] = sum((n.fault_codes for n in nights), Counter())
    orders = sum(len(n.observer.orders) for n in nights)
    print(f"{orders} orders in {took_s:.0f} s, {sum(len(n.samples) for n in nights)} lives of the daemon")
    for title, rows in (("with", faults), ("ended as", results)):
        for name, count in rows.most_common():
            print(f"  {title:9} {name:32} {count:6}")
    print("  faults reset:", ", ".join(f"{code} x{n}" for code, n in codes.most_common()) or "none")
    every = [order for n in nights for order in n.observer.orders.values()]
    print(
        f"  most of one order: {max(o.motions for o in every)} motions, {max(o.grasps for o in every)} grasps"
    )
    for n in nights:
        print("  parts:", ", ".join(f"{name} {count}" for name, count in n.balance.items()))
        longest = max(n.samples, key=len)
        for one in (longest[0], longest[len(longest) // 2], longest[-1]):
            print(
                f"  longest life, order {one.delivered:5}: {one.files} files, {one.threads} threads, "
                f"{one.processes} processes, {one.memory_mb:.0f} MB"
            )
    print(f"  strange: {[s for n in nights for s in n.observer.strange] or 'nothing'}")
