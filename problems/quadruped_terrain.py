"""Quadrupeds walk over terrain from standing to standing: stairs, slopes, uneven steps, stones, waves."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.problem import Choice, Family, Parameter, Problem
from trajopt.robot import quadruped_legs
from trajopt.terrain import REACH, FlatGround, Patch, PiecewiseTerrain, SmoothTerrain, Terrain, Wave

from . import common
from .gait_common import ROBOTS
from .terrain_walks import Walker, parameters, problem_over, walker

# Default lengths over the robot's. Rise and run of stairs have the ratio of those in houses. For uneven steps
# the values are heights above the ground before them; for a slope, its length seen from above; for stones,
# their sides, the distances of their centres, and their differences in height.
LENGTHS = {
    "rise": 0.2,
    "run": 0.6,
    "height1": 0.15,
    "height2": 0.05,
    "height3": 0.25,
    "height4": 0.1,
    "length": 2.0,
    "size": 0.4,
    "spacing": 0.6,
    "uneven": 0.1,
    "amplitude": 0.1,
    "wavelength": 2.0,
}
STAIRS, STONES = 3, 4
SLOPE = math.radians(15)
# Distance walked over waves, in strides of the gait.
STRIDES = 2.0

# The terrain, and the distance across it in m.
Built = tuple[Terrain, float]


def _stairs(walker: Walker, *, rise: float, run: float, steps: float) -> Built:
    count = common.whole("steps", steps)
    return PiecewiseTerrain.stairs(rise, run, count, **walker.placed), walker.way_across((count - 1) * run)


def _steps(walker: Walker, *, run: float, **heights: float) -> Built:
    terrain = PiecewiseTerrain.steps(list(heights.values()), run, **walker.placed)
    return terrain, walker.way_across((len(heights) - 1) * run)


def _slope(walker: Walker, *, ground: str, slope: float, length: float) -> Built:
    if ground == "endless":
        return FlatGround(friction=walker.friction, normal=(-math.sin(slope), 0.0, math.cos(slope))), length
    ramp = PiecewiseTerrain.slope(math.tan(slope) * length, length, **walker.placed)
    return ramp, walker.way_across(length)


def _stones(walker: Walker, *, stones: float, size: float, spacing: float, uneven: float) -> Built:
    """Return two rows of stones, under the feet of each side, between two banks."""
    count, gap = common.whole("stones", stones), spacing - size
    if not gap > 0:
        raise InputError(f"stones of {size:g} m are {spacing:g} m apart", "allowed: spacing above their size")
    legs = quadruped_legs(walker.robot)
    sides = ((legs.front_left, legs.hind_left), (legs.front_right, legs.hind_right))
    rows = [float(np.mean([walker.feet[name][1] for name in side])) for side in sides]
    first = walker.edge + gap + size / 2
    centres = [(first + i * spacing, row) for row in rows for i in range(count)]
    heights = [uneven * (_halton(i + 1, base) - 0.5) for base in (2, 3) for i in range(count)]
    kept: dict[str, Any] = {"friction": walker.friction, "margin": walker.margin}
    blocks = PiecewiseTerrain.stepping_stones(centres, size, heights, **kept)
    extent = count * spacing + gap
    banks = [
        Patch.rectangle((x, 0.0, 0.0), (REACH, 2 * REACH), **kept, name=name)
        for name, x in (("before", walker.edge - REACH / 2), ("beyond", walker.edge + extent + REACH / 2))
    ]
    return PiecewiseTerrain(faces=(banks[0], *blocks.faces, banks[1])), walker.way_across(extent)


def _waves(walker: Walker, *, amplitude: float, wavelength: float, yaw: float, way: float) -> Built:
    wave = Wave(amplitude=amplitude, wavelength=wavelength, yaw=yaw)
    return SmoothTerrain(shapes=(wave,), friction=walker.friction), way


def _halton(index: int, base: int) -> float:
    """Return Van der Corput's sequence: evenly spread, deterministic numbers in (0, 1)."""
    number, part = 0.0, 1.0
    while index:
        index, digit = divmod(index, base)
        part /= base
        number += part * digit
    return number


def _length(name: str, meaning: str, within: common.Range) -> Parameter:
    default = f"{LENGTHS[name]:g} of the robot's length"
    return common.length(name, None, f"{meaning} (default: {default})", within)


def _count(name: str, default: int, meaning: str) -> Parameter:
    return common.number(name, float(default), "", meaning, (1.0, 20.0))


def _family(
    name: str, summary: str, made: Callable[..., Built], *first: Parameter | Choice, kept: bool = True
) -> Family:
    """Return the family whose terrain and distance ``made`` computes from the ``first`` parameters.

    kept: whether the terrain has edges, from which feet keep a margin.
    """

    def build(*, footholds: str, torque_share: float, **given: Any) -> Problem:
        """Build the walk; see the family's parameters. Raises InputError."""
        chosen = {parameter.name: given.pop(parameter.name) for parameter in first}
        body = walker(**given)
        defaults = {key: part * body.length for key, part in LENGTHS.items()} | {"way": STRIDES * body.stride}
        derived = {key: defaults[key] if value is None else value for key, value in chosen.items()}
        terrain, way = made(body, **derived)
        if kept:
            derived["margin"] = body.margin
        return problem_over(
            name, body, terrain, way, footholds=footholds, torque_share=torque_share, parameters=derived
        )

    return Family(
        name=name,
        robots=ROBOTS,
        phases=("stand", "rest"),
        summary=summary,
        parameters=parameters(*first, margin=kept),
        build=build,
    )


FAMILIES = (
    _family(
        "quadruped-stairs",
        "walk up stairs, or down with a negative rise",
        _stairs,
        _length("rise", "height of a step, negative: down", (-0.5, 0.5)),
        _length("run", "depth of a tread", (0.05, 2.0)),
        _count("steps", STAIRS, "number of steps"),
    ),
    _family(
        "quadruped-steps",
        "walk over steps of different heights",
        _steps,
        _length("run", "depth of a tread", (0.05, 2.0)),
        *(
            _length(f"height{i}", f"height of tread {i} above the ground at the start", (-1.0, 1.0))
            for i in range(1, 5)
        ),
    ),
    _family(
        "quadruped-slope",
        "walk up a slope between two flats (down with a negative angle), or on an endless one",
        _slope,
        common.choice("ground", "slope between flats, or endless", "between-flats", "endless"),
        common.angle("slope", SLOPE, "angle of the slope, positive: rises forward", (-0.6, 0.6)),
        _length("length", "horizontal length of the slope, or of the path on an endless one", (0.05, 5.0)),
    ),
    _family(
        "quadruped-stepping-stones",
        "walk over two rows of stones of different heights between two banks",
        _stones,
        _count("stones", STONES, "number of stones in a row"),
        _length("size", "side length of a stone", (0.02, 2.0)),
        _length("spacing", "distance between stone centres along the path", (0.02, 3.0)),
        _length("uneven", "range of the stones' heights", (0.0, 0.5)),
    ),
    _family(
        "quadruped-waves",
        "walk over smooth waves",
        _waves,
        _length("amplitude", "amplitude of the waves", (0.0, 0.5)),
        _length("wavelength", "wavelength of the waves", (0.1, 20.0)),
        common.angle("yaw", 0.0, "direction of the waves, to the left of forward", (-math.pi, math.pi)),
        common.length("way", None, "forward displacement (default: two strides of the gait)", (0.0, 5.0)),
        kept=False,
    ),
)
