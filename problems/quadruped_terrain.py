"""Quadrupeds walk over terrain from standing to standing: stairs, slopes, uneven steps, stones, waves."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.family import Choice, Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import REACH, PiecewiseTerrain
from trajopt.terrain.shapes import Wave
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.terrain import Terrain

from . import common
from .gait_common import ROBOTS
from .terrain_walks import Walker, parameters, problem_over, walker

# Rise and depth of a stair as parts of the robot's length; their ratio is that of stairs in houses.
RISE, RUN, STAIRS = 0.2, 0.6, 3
# Length of a slope, seen from above, in the robot's lengths; its angle, rad.
SLOPE_LENGTH, SLOPE = 2.0, math.radians(15)
# Heights of uneven steps over the ground before them, parts of the robot's length.
HEIGHTS = (0.15, 0.05, 0.25, 0.1)
# Stones: sides and distances of their centres, and how much their heights differ, in the robot's lengths.
STONE, SPACING, UNEVEN, STONES = 0.4, 0.6, 0.1, 4
# Waves: amplitude and length in the robot's lengths; the way over them in strides of the gait.
AMPLITUDE, WAVELENGTH, STRIDES = 0.1, 2.0, 2.0

Built = tuple[Terrain, float, dict[str, object]]


def _stairs(own: Walker, *, rise: float | None, run: float | None, steps: float) -> Built:
    rise = RISE * own.length if rise is None else rise
    run = RUN * own.length if run is None else run
    count = _whole("steps", steps)
    terrain = PiecewiseTerrain.stairs(
        rise, run, count, at=(own.edge, 0.0), friction=own.friction, margin=own.margin
    )
    return terrain, own.way_across((count - 1) * run), {"rise": rise, "run": run}


def _steps(own: Walker, *, run: float | None, **given: float | None) -> Built:
    run = RUN * own.length if run is None else run
    heights = {
        name: part * own.length if given[name] is None else given[name]
        for name, part in zip(sorted(given), HEIGHTS, strict=True)
    }
    terrain = PiecewiseTerrain.steps(
        list(heights.values()), run, at=(own.edge, 0.0), friction=own.friction, margin=own.margin
    )
    return terrain, own.way_across((len(heights) - 1) * run), {"run": run, **heights}


def _slope(own: Walker, *, ground: str, slope: float, length: float | None) -> Built:
    length = SLOPE_LENGTH * own.length if length is None else length
    if ground == "endless":
        terrain = FlatGround(friction=own.friction, normal=(-math.sin(slope), 0.0, math.cos(slope)))
        return terrain, length, {"length": length}
    rise = math.tan(slope) * length
    ramp = PiecewiseTerrain.slope(rise, length, at=(own.edge, 0.0), friction=own.friction, margin=own.margin)
    return ramp, own.way_across(length), {"length": length}


def _stones(
    own: Walker, *, stones: float, size: float | None, spacing: float | None, uneven: float | None
) -> Built:
    """Two rows of stones under the feet of both sides, between two banks."""
    size = STONE * own.length if size is None else size
    spacing = SPACING * own.length if spacing is None else spacing
    uneven = UNEVEN * own.length if uneven is None else uneven
    count, gap = _whole("stones", stones), spacing - size
    if not gap > 0:
        raise InputError(f"stones of {size:g} m are {spacing:g} m apart", "allowed: spacing above their size")
    rows = [
        float(np.mean([own.feet[name][1] for name in side]))
        for side in (
            (own.legs.front_left, own.legs.hind_left),
            (own.legs.front_right, own.legs.hind_right),
        )
    ]
    first = own.edge + gap + size / 2
    centres = [(first + i * spacing, row) for row in rows for i in range(count)]
    heights = [uneven * (_halton(i + 1, base) - 0.5) for base in (2, 3) for i in range(count)]
    blocks = PiecewiseTerrain.stepping_stones(
        centres, size, heights, friction=own.friction, margin=own.margin
    )
    extent = count * spacing + gap
    banks = [
        Patch.rectangle(
            (x, 0.0, 0.0), (REACH, 2 * REACH), friction=own.friction, margin=own.margin, name=name
        )
        for name, x in (("before", own.edge - REACH / 2), ("beyond", own.edge + extent + REACH / 2))
    ]
    terrain = PiecewiseTerrain(faces=(banks[0], *blocks.faces, banks[1]))
    return terrain, own.way_across(extent), {"size": size, "spacing": spacing, "uneven": uneven}


def _waves(
    own: Walker, *, amplitude: float | None, wavelength: float | None, yaw: float, way: float | None
) -> Built:
    amplitude = AMPLITUDE * own.length if amplitude is None else amplitude
    wavelength = WAVELENGTH * own.length if wavelength is None else wavelength
    way = STRIDES * own.stride if way is None else way
    terrain = SmoothTerrain(
        shapes=(Wave(amplitude=amplitude, wavelength=wavelength, yaw=yaw),), friction=own.friction
    )
    return terrain, way, {"amplitude": amplitude, "wavelength": wavelength, "way": way}


def _halton(index: int, base: int) -> float:
    """Van der Corput's sequence: evenly spread numbers in (0, 1) without chance."""
    found, part = 0.0, 1.0
    while index:
        index, digit = divmod(index, base)
        part /= base
        found += part * digit
    return found


def _whole(name: str, value: float) -> int:
    if value != round(value):
        raise InputError(f"parameter {name} is {value:g}", "allowed: a whole number")
    return round(value)


def _length(name: str, part: str, meaning: str, within: common.Range) -> Parameter:
    return common.length(name, None, f"{meaning} (default: {part} of the robot's length)", within)


def _count(name: str, default: int, meaning: str) -> Parameter:
    return Parameter(name=name, default=float(default), unit="", lower=1.0, upper=20.0, meaning=meaning)


def _family(
    name: str, summary: str, made: Callable[..., Built], *own: Parameter | Choice, kept: bool = True
) -> Family:
    """The family whose terrain, way and derived parameters ``made`` gives from its ``own`` parameters.

    kept: feet keep a margin from edges, of which there are some.
    """
    given = [parameter.name for parameter in own]

    def build(
        *,
        robot: str,
        gait: str,
        footholds: str,
        cycles: float | None,
        clearance: float | None,
        friction: float,
        effort_share: float,
        margin: float | None = None,
        **values: float | str | None,
    ) -> Problem:
        """Build the walk; see the family's parameters. Raises InputError."""
        body = walker(
            robot=robot, gait=gait, cycles=cycles, clearance=clearance, margin=margin, friction=friction
        )
        terrain, way, derived = made(body, **{key: values[key] for key in given})
        if kept:
            derived["margin"] = body.margin
        return problem_over(
            name, body, terrain, way, footholds=footholds, effort_share=effort_share, parameters=derived
        )

    return Family(
        name=name,
        robots=ROBOTS,
        phases=("stand", "rest"),
        summary=summary,
        parameters=parameters(*own, margin=kept),
        build=build,
    )


FAMILIES = (
    _family(
        "quadruped-stairs",
        "up stairs, or down with a negative rise",
        _stairs,
        _length("rise", "0.2", "of a step, down if negative", (-0.5, 0.5)),
        _length("run", "0.6", "depth of a tread", (0.05, 2.0)),
        _count("steps", STAIRS, "number of steps"),
    ),
    _family(
        "quadruped-steps",
        "over steps of any heights",
        _steps,
        _length("run", "0.6", "depth of a tread", (0.05, 2.0)),
        *(
            _length(f"height{i}", f"{part:g}", "of a tread over the ground before them", (-1.0, 1.0))
            for i, part in enumerate(HEIGHTS, start=1)
        ),
    ),
    _family(
        "quadruped-slope",
        "up a slope between two flats, down with a negative angle, or along an endless one",
        _slope,
        Choice(
            name="ground",
            default="between-flats",
            choices=("between-flats", "endless"),
            meaning="what is before and behind the slope",
        ),
        common.angle("slope", SLOPE, "rises forward", (-0.6, 0.6)),
        _length("length", "2", "of the slope, or of the way along an endless one, from above", (0.05, 5.0)),
    ),
    _family(
        "quadruped-stepping-stones",
        "over two rows of stones of different heights between two banks",
        _stones,
        _count("stones", STONES, "number of stones in a row"),
        _length("size", "0.4", "sides of a stone", (0.02, 2.0)),
        _length("spacing", "0.6", "between centres of stones along the way", (0.02, 3.0)),
        _length("uneven", "0.1", "range of the stones' heights", (0.0, 0.5)),
    ),
    _family(
        "quadruped-waves",
        "over smooth waves",
        _waves,
        _length("amplitude", "0.1", "of the waves", (0.0, 0.5)),
        _length("wavelength", "2", "of the waves", (0.1, 20.0)),
        common.angle("yaw", 0.0, "direction of the waves, to the left of forward", (-math.pi, math.pi)),
        common.length("way", None, "forward (default: two strides of the gait)", (0.0, 5.0)),
        kept=False,
    ),
)
