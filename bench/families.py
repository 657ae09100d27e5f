"""What lies on the table in each family of bench scenes, and under which light.

Families as in rendered scene sets: A spread, B five overlapping, H10, H20, H40 heaps as dense as physical
ones, T tilted, F many kinds, L under hard lights, N nothing to be found. Every scene is drawn from its own
random numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.heap import MOVES, Block, Rod, settle
from bench.rigs import MIDDLE_M, TABLE_Z_M, Rig
from bench.views import TABLE_STEP_M, TABLES, Look
from vision.types import Floats, read_only

COLOURS = {
    "wood": np.array([0.53, 0.71, 0.83]),
    "blue": np.array([0.45, 0.12, 0.05]),
    "red": np.array([0.04, 0.05, 0.55]),
    "green": np.array([0.10, 0.35, 0.10]),
    "yellow": np.array([0.06, 0.60, 0.75]),
    "white": np.array([0.78, 0.80, 0.80]),
}
"""Linear light, BGR."""
TABLE_TONES = {"wood": np.array([0.024, 0.033, 0.046]), "mat": np.array([0.023, 0.021, 0.019])}
DIAMETER_M = 0.0038
DENSITY = {5: (0.36, 1), 10: (0.52, 2), 20: (0.59, 3), 40: (0.56, 3)}
"""By number of sticks: radius of the disc on which they fall, in lengths of a stick, and throws of each.

Chosen for 2.7, 3.5, 6 and 13 crossings per stick, and for heaps as high and as steep as physical ones.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One kind of rod; ``colour`` a word of `COLOURS`, ``gloss`` 0 dull to 1."""

    length_m: float
    diameter_m: float
    colour: str = "wood"
    gloss: float = 0.0


OTHERS = (
    Kind(length_m=0.09, diameter_m=DIAMETER_M, colour="blue", gloss=0.15),
    Kind(length_m=0.09, diameter_m=0.0064, colour="red", gloss=0.15),
    Kind(length_m=0.07, diameter_m=0.0024, colour="white"),
    Kind(length_m=0.06, diameter_m=DIAMETER_M, colour="yellow", gloss=0.15),
    Kind(length_m=0.12, diameter_m=DIAMETER_M, colour="green", gloss=0.15),
)
"""What lies among the wanted sticks of family F; lengths for the rig with sticks of 0.1 m. Only the first
is as long and as wide as the wanted ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What a scene asks the detector for: sticks of this size, of a ``colour`` where one is named."""

    length_m: float
    diameter_m: float
    colour: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenery:
    """One scene before it is photographed. ``picks``: whether anything is to be found."""

    rods: tuple[Rod, ...]
    blocks: tuple[Block, ...] = ()
    look: Look
    wish: Wish
    picks: bool = True
    note: str = ""


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
        table_tone=TABLE_TONES[kind] * rng.uniform(0.75, 1.3),
        pattern=np.array([np.cos(angle), np.sin(angle), *shift.tolist(), TABLE_STEP_M]),
        glare=np.zeros(2),
        field=np.zeros(9),
        exposure=float(rng.uniform(1.0, 1.22)),
        noise=float(rng.uniform(0.9, 1.2)),
    )


def disc(count: int, radius_m: float, rng: np.random.Generator, throws: int) -> Floats:
    """Poses (N, K, 3) to drop ``count`` rods at: anywhere on a disc about the middle, any heading."""
    shape = (count, throws)
    far, turn = radius_m * np.sqrt(rng.random(shape)), rng.uniform(0.0, 2.0 * np.pi, shape)
    heading = rng.uniform(0.0, np.pi, shape)
    x, y = MIDDLE_M[0] + far * np.cos(turn), MIDDLE_M[1] + far * np.sin(turn)
    return np.stack([x, y, heading], axis=-1)


def dropped(
    throws: Floats,
    kinds: tuple[Kind, ...],
    rng: np.random.Generator,
    *,
    blocks: tuple[Block, ...] = (),
    moves: int = MOVES,
) -> tuple[Rod, ...]:
    """Rods of these kinds, dropped one after another; ``throws`` as `bench.heap.settle` takes them."""
    count = len(kinds)
    lengths = np.array([kind.length_m for kind in kinds]) + rng.normal(0.0, 0.0002, count)
    radii = 0.5 * np.array([kind.diameter_m for kind in kinds]) + rng.normal(0.0, 0.00002, count)
    centres, axes = settle(throws, lengths, radii, TABLE_Z_M, blocks=blocks, moves=moves)
    rods = []
    for n, kind in enumerate(kinds):
        tint = np.array([rng.normal(1.0, 0.05), 1.0, 1.0])  # wood differs in its yellow
        rods.append(
            Rod(
                length_m=float(lengths[n]),
                radius_m=float(radii[n]),
                colour=read_only(COLOURS[kind.colour] * tint),
                colour_name=kind.colour,
                material="wood" if kind.gloss == 0.0 else "paint",
                shade=float(np.clip(rng.normal(0.97, 0.045), 0.82, 1.1)),
                gloss=kind.gloss,
                target=True,
                centre=centres[n],
                axis=axes[n],
            )
        )
    return tuple(rods)


def heap(count: int, rig: Rig, rng: np.random.Generator) -> Scenery:
    """Sticks thrown on one heap, as dense as a physical one of as many."""
    length_m = rig.stick_length_m
    reach, throws_each = DENSITY[min(DENSITY, key=lambda known: abs(known - count))]
    middle = rng.normal(0.0, 0.006, 2)
    throws = disc(count, reach * length_m, rng, throws_each)
    throws[:, :, :2] += middle
    return Scenery(
        rods=dropped(throws, (Kind(length_m=length_m, diameter_m=DIAMETER_M),) * count, rng),
        look=look_of(rng),
        wish=Wish(length_m=length_m, diameter_m=DIAMETER_M),
    )


def apart(rig: Rig, rng: np.random.Generator) -> Scenery:
    """A: three to six sticks, none of which touches another."""
    length_m, wanted = rig.stick_length_m, int(rng.integers(3, 7))
    laid: list[Floats] = []
    while len(laid) < wanted:
        pose = disc(1, 1.1 * length_m, rng, 1)[0, 0]
        if all(_clearance_m(pose, other, length_m) > 0.012 for other in laid):
            laid.append(pose)
    return Scenery(
        rods=dropped(
            np.array(laid)[:, None], (Kind(length_m=length_m, diameter_m=DIAMETER_M),) * wanted, rng
        ),
        look=look_of(rng),
        wish=Wish(length_m=length_m, diameter_m=DIAMETER_M),
    )


def _clearance_m(a: Floats, b: Floats, length_m: float) -> float:
    """Smallest distance of two sticks in plan, sampled every few millimetres."""
    at = np.linspace(-0.5, 0.5, 41)[:, None] * length_m
    one = a[:2] + at * np.array([np.cos(a[2]), np.sin(a[2])])
    two = b[:2] + at * np.array([np.cos(b[2]), np.sin(b[2])])
    return float(np.linalg.norm(one[:, None] - two[None], axis=2).min())


def many_kinds(rig: Rig, rng: np.random.Generator) -> Scenery:
    """F: a heap of many kinds, of which only the wooden sticks of one length are asked for.

    Before a grey camera nothing differs from them in colour alone.
    """
    length_m = round(0.9 * rig.stick_length_m, 6)
    scale = rig.stick_length_m / 0.1
    known = OTHERS[1:] if rig.mono else OTHERS
    others = [known[k] for k in rng.permutation(len(known))[: int(rng.integers(3, len(known) + 1))]]
    kinds = [Kind(length_m=length_m, diameter_m=DIAMETER_M)] * 4
    kinds += [Kind(length_m=0.13 * scale, diameter_m=DIAMETER_M)] * 2
    kinds += [Kind(length_m=0.06 * scale, diameter_m=DIAMETER_M)] * 2
    kinds += [replace(kind, length_m=kind.length_m * scale) for kind in others]
    order = rng.permutation(len(kinds))
    shuffled = tuple(kinds[k] for k in order)
    rods = dropped(disc(len(kinds), 0.6 * rig.stick_length_m, rng, 2), shuffled, rng)
    return Scenery(
        rods=tuple(replace(rod, target=order[n] < 4) for n, rod in enumerate(rods)),
        look=look_of(rng),
        wish=Wish(length_m=length_m, diameter_m=DIAMETER_M, colour=None if rig.mono else "wood"),
    )


def tilted(rig: Rig, rng: np.random.Generator, parallel: bool) -> Scenery:
    """T: three sticks that lean on a block at 10 to 40 degrees, or run nearly along the baseline."""
    length_m = rig.stick_length_m
    tilt, lap_m = np.radians(rng.uniform(10.0, 40.0)), 0.12 * length_m
    turn = float(np.radians(rng.normal(0.0, 2.0) if parallel else rng.uniform(-45.0, 45.0)))
    block = Block(
        middle=np.array(MIDDLE_M) + rng.normal(0.0, 0.006, 2),
        half_m=length_m * rng.uniform(0.25, 0.4, 2),
        turn_rad=turn,
        height_m=float(np.tan(tilt) * (length_m * np.cos(tilt) - lap_m)),
        colour=rng.uniform(0.05, 0.13) * np.array([1.15, 1.05, 1.0]),
    )
    sides = (0, 2, 1) if parallel else tuple(rng.permutation(4)[:3].tolist())
    poses = []
    for n, side in enumerate(sides):
        out = turn + 0.5 * np.pi * side
        away = block.half_m[side % 2] - rng.uniform(0.06, 0.18) * length_m
        along = rng.uniform(-0.6, 0.6) * block.half_m[1 - side % 2]
        lean = np.radians(rng.normal(0.0, 1.5) if parallel else rng.uniform(-30.0, 30.0))
        # the upper end lies on the block, the lower one on the table, the edge between them
        edge = block.middle + away * np.array([np.cos(out), np.sin(out)])
        edge += along * np.array([-np.sin(out), np.cos(out)])
        heading = out + lean
        half_m = 0.5 * length_m * np.cos(tilt)
        centre = edge + half_m * np.array([np.cos(heading), np.sin(heading)])
        if parallel and n == 2:  # one flat on the table, along the baseline
            centre, heading = block.middle + np.array([0.0, block.half_m[1] + 0.2 * length_m]), lean
        poses.append([centre[0], centre[1], heading])
    rods = dropped(
        np.array(poses)[:, None],
        (Kind(length_m=length_m, diameter_m=DIAMETER_M),) * 3,
        rng,
        blocks=(block,),
        moves=0,
    )
    return Scenery(
        rods=rods,
        blocks=(block,),
        look=look_of(rng),
        wish=Wish(length_m=length_m, diameter_m=DIAMETER_M),
        note="parallel" if parallel else "tilted",
    )


def lit(rig: Rig, rng: np.random.Generator, kind: str) -> Scenery:
    """L: five sticks in dim light, under a glare, in a gradient or across the edge of a hard shadow."""
    scene = heap(5, rig, rng)
    look = scene.look
    way = rng.uniform(0.0, 2.0 * np.pi)
    normal = np.array([np.cos(way), np.sin(way)])
    span_m = rig.stick_length_m
    field_of = look.field.copy()
    if kind == "dim":
        look = replace(look, exposure=float(rng.uniform(0.28, 0.45)), noise=float(rng.uniform(1.6, 2.2)))
    elif kind == "glare":
        spot = np.array([*MIDDLE_M, TABLE_Z_M]) + np.array([*rng.normal(0.0, 0.35 * span_m, 2), 0.0])
        eye = np.array(rig.cameras.left.position_m)
        mirrored = (spot - eye) * np.array([1.0, 1.0, -1.0])
        look = replace(
            look,
            lamp_m=spot + mirrored * rng.uniform(1.3, 2.0),
            lamp=0.75,
            glare=np.array([rng.uniform(0.5, 1.4), rng.uniform(1.5, 5.0) * (eye[2] / span_m) ** 2 * 8.0]),
        )
    elif kind == "gradient":
        field_of[:2] = normal * rng.uniform(0.3, 0.5) / span_m
        field_of[2:4] = MIDDLE_M
        look = replace(look, field=field_of)
    elif kind == "shadow":
        offset = normal @ np.array(MIDDLE_M) + rng.normal(0.0, 0.15 * span_m)
        field_of[4:] = [*normal.tolist(), float(offset), rng.uniform(0.001, 0.006), rng.uniform(0.6, 0.95)]
        look = replace(look, field=field_of)
    return replace(scene, look=look, note=kind)


def nothing(rig: Rig, rng: np.random.Generator, kind: str) -> Scenery:
    """N: nothing to be found: an empty table, sticks of another length or width, an overexposed picture."""
    length_m, count = rig.stick_length_m, int(rng.integers(3, 7))
    look = look_of(rng)
    if kind == "empty":
        rods: tuple[Rod, ...] = ()
    elif kind == "length":
        factors = rng.choice([0.45, 0.55, 0.65, 0.75, 1.3, 1.4, 1.5], count)
        kinds = tuple(Kind(length_m=float(f) * length_m, diameter_m=DIAMETER_M) for f in factors)
        rods = dropped(disc(count, 0.5 * length_m, rng, 1), kinds, rng)
    elif kind == "width":
        widths = rng.choice([1.6, 2.0, 6.5, 8.0], count)
        kinds = tuple(Kind(length_m=length_m, diameter_m=0.001 * float(w)) for w in widths)
        rods = dropped(disc(count, 0.5 * length_m, rng, 1), kinds, rng)
    else:
        rods = heap(5, rig, rng).rods
        look = replace(look, exposure=40.0)
    return Scenery(
        rods=tuple(replace(rod, target=False) for rod in rods),
        look=look,
        wish=Wish(length_m=length_m, diameter_m=DIAMETER_M),
        picks=False,
        note=kind,
    )


def scenery(family: str, rig: Rig, rng: np.random.Generator, number: int = 0) -> Scenery:
    """One scene of a family; families with kinds of scenes take turns by ``number``.

    Raises
    ------
    ValueError
        There is no such family.
    """
    match family:
        case "A":
            return apart(rig, rng)
        case "B":
            return heap(5, rig, rng)
        case "H10" | "H20" | "H40":
            return heap(int(family[1:]), rig, rng)
        case "F":
            return many_kinds(rig, rng)
        case "T":
            return tilted(rig, rng, parallel=bool(number % 2))
        case "L":
            return lit(rig, rng, LIGHTS[number % len(LIGHTS)])
        case "N":
            return nothing(rig, rng, NOTHINGS[number % len(NOTHINGS)])
    raise ValueError(f"no family {family!r}; there are {', '.join(FAMILIES)}")


FAMILIES = ("A", "B", "H10", "H20", "H40", "T", "F", "L", "N")
LIGHTS = ("dim", "glare", "gradient", "shadow")
NOTHINGS = ("empty", "length", "width", "saturated")
