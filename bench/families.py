"""What lies on the table in each family of bench scenes, and under which light.

Families as in rendered scene sets: A spread, B five overlapping, H10, H20, H40 heaps as dense as physical ones.
Every scene is drawn from its own random numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bench.heap import Block, Rod, settle
from bench.rigs import MIDDLE_M, TABLE_Z_M, Rig
from bench.views import TABLE_STEP_M, TABLES, Look
from vision.types import Floats, read_only

WOOD = np.array([0.54, 0.72, 0.84])
TABLES_TONE = {"wood": np.array([0.027, 0.037, 0.052]), "mat": np.array([0.030, 0.027, 0.025])}
DIAMETER_M = 0.0038
REACH = {5: 0.42, 10: 0.58, 20: 0.61, 40: 0.46}
"""Radius of the disc on which centres fall, in lengths of a stick: gives 3.5, 6 and 13 crossings per stick."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What a scene asks the detector for."""

    length_m: float
    diameter_m: float
    colour: str | None = None
    any: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenery:
    """One scene before it is photographed. ``picks``: whether anything is to be found."""

    rods: tuple[Rod, ...]
    blocks: tuple[Block, ...] = ()
    look: Look
    wish: Wish
    picks: bool = True
    note: str = field(default="")


def look_of(rng: np.random.Generator) -> Look:
    """An ordinary light: one lamp from a side, the room around it."""
    turn, rise, far = (
        rng.uniform(0.0, 2.0 * np.pi),
        np.radians(rng.uniform(42.0, 72.0)),
        rng.uniform(0.7, 1.1),
    )
    lamp_m = np.array(
        [
            MIDDLE_M[0] + far * np.cos(turn) * np.cos(rise),
            MIDDLE_M[1] + far * np.sin(turn) * np.cos(rise),
            TABLE_Z_M + far * np.sin(rise),
        ]
    )
    room = float(rng.uniform(0.28, 0.55))
    kind = "wood" if rng.random() < 0.6 else "mat"
    angle = rng.normal(0.0, 0.15) + 0.5 * np.pi * float(rng.random() < 0.25)
    shift = rng.uniform(0.0, 0.3, 2)
    return Look(
        lamp_m=lamp_m,
        lamp_radius_m=float(rng.uniform(0.04, 0.14)),
        lamp=(1.1 - room) / float(np.sin(rise)),
        room=room,
        table=kind,
        table_number=int(rng.integers(TABLES)),
        table_tone=TABLES_TONE[kind] * rng.uniform(0.75, 1.3),
        pattern=np.array([np.cos(angle), np.sin(angle), *shift.tolist(), TABLE_STEP_M]),
        glare=np.zeros(2),
        field=np.zeros(9),
        exposure=float(rng.uniform(0.9, 1.12)),
        noise=float(rng.uniform(0.9, 1.2)),
    )


def disc(count: int, radius_m: float, rng: np.random.Generator) -> Floats:
    """``count`` poses (N, 3) to drop rods at: anywhere on a disc about the middle, any heading."""
    far, turn = radius_m * np.sqrt(rng.random(count)), rng.uniform(0.0, 2.0 * np.pi, count)
    heading = rng.uniform(0.0, np.pi, count)
    return np.column_stack([MIDDLE_M[0] + far * np.cos(turn), MIDDLE_M[1] + far * np.sin(turn), heading])


def sticks(
    poses: Floats, length_m: float, rng: np.random.Generator, *, diameter_m: float = DIAMETER_M
) -> tuple[Rod, ...]:
    """Wooden sticks of one kind, dropped one after another."""
    count = len(poses)
    lengths = length_m + rng.normal(0.0, 0.0002, count)
    radii = 0.5 * diameter_m + rng.normal(0.0, 0.00002, count)
    centres, axes = settle(poses, lengths, radii, TABLE_Z_M)
    brightness = rng.normal(0.97, 0.045, count)
    return tuple(
        Rod(
            length_m=float(lengths[n]),
            radius_m=float(radii[n]),
            colour=read_only(WOOD * np.array([rng.normal(1.0, 0.05), 1.0, 1.0])),
            colour_name="wood",
            material="wood",
            shade=float(np.clip(brightness[n], 0.82, 1.1)),
            gloss=0.0,
            target=True,
            centre=centres[n],
            axis=axes[n],
        )
        for n in range(count)
    )


def heap(count: int, rig: Rig, rng: np.random.Generator) -> Scenery:
    """Sticks thrown on one heap, as dense as a physical one of as many."""
    length_m = rig.stick_length_m
    reach = float(np.interp(count, list(REACH), list(REACH.values())))
    middle = rng.normal(0.0, 0.006, 2)
    poses = disc(count, reach * length_m, rng)
    poses[:, :2] += middle
    return Scenery(
        rods=sticks(poses, length_m, rng),
        look=look_of(rng),
        wish=Wish(length_m=length_m, diameter_m=DIAMETER_M),
    )


def apart(rig: Rig, rng: np.random.Generator) -> Scenery:
    """A: three to six sticks, none of which touches another."""
    length_m, wanted = rig.stick_length_m, int(rng.integers(3, 7))
    laid: list[Floats] = []
    while len(laid) < wanted:
        pose = disc(1, 0.11 * length_m / 0.1, rng)[0]
        if all(_clearance_m(pose, other, length_m) > 0.012 for other in laid):
            laid.append(pose)
    return Scenery(
        rods=sticks(np.array(laid), length_m, rng),
        look=look_of(rng),
        wish=Wish(length_m=length_m, diameter_m=DIAMETER_M),
    )


def _clearance_m(a: Floats, b: Floats, length_m: float) -> float:
    """Smallest distance of two sticks in plan, sampled every few millimetres."""
    at = np.linspace(-0.5, 0.5, 41)[:, None] * length_m
    one = a[:2] + at * np.array([np.cos(a[2]), np.sin(a[2])])
    two = b[:2] + at * np.array([np.cos(b[2]), np.sin(b[2])])
    return float(np.linalg.norm(one[:, None] - two[None], axis=2).min())


def few(rig: Rig, rng: np.random.Generator) -> Scenery:
    """B: five sticks over one another."""
    return heap(5, rig, rng)


def scenery(family: str, rig: Rig, rng: np.random.Generator) -> Scenery:
    """One scene of a family.

    Raises
    ------
    ValueError
        There is no such family.
    """
    match family:
        case "A":
            return apart(rig, rng)
        case "B":
            return few(rig, rng)
        case "H10" | "H20" | "H40":
            return heap(int(family[1:]), rig, rng)
    raise ValueError(f"no family {family!r}; there are {', '.join(FAMILIES)}")


FAMILIES = ("A", "B", "H10", "H20", "H40")
