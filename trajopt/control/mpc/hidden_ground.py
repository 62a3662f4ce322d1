"""Ground ahead of a robot that its controller does not know: a slope, or boxes of random height."""

import math

import numpy as np

from trajopt.arguments import Count, Fraction, checked
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import REACH, PiecewiseTerrain

# Length of the level ground in front of the robot's origin, m.
DISTANCE = 0.5
# Steepest slope, degrees: far steeper than a coefficient of friction of 0.7 allows.
STEEPEST = 60.0
# Numbers of boxes along and across; their side over the robot's length, its minimum in m; gaps over the side.
ALONG, ACROSS, SIDE, LEAST_SIDE, GAP = 10, 6, 0.8, 0.25, 0.2


@checked
def slope_ahead(degrees: float) -> PiecewiseTerrain:
    """Level ground, followed from `DISTANCE` m on by a slope about the lateral axis.

    Args:
        degrees: inclination of the slope, degrees, negative downwards.

    Raises:
        InputError: for a slope steeper than `STEEPEST`.
    """
    if not abs(degrees) <= STEEPEST:
        raise InputError(f"slope is {degrees:g} degrees", f"allowed: {-STEEPEST:g} to {STEEPEST:g}")
    rise = REACH * math.tan(math.radians(degrees))
    return PiecewiseTerrain.slope(rise, REACH, at=(DISTANCE, 0.0))


@checked
def boxes_ahead(robot: Robot, part: Fraction, seed: Count = 0) -> PiecewiseTerrain:
    """Level ground with rows of boxes from `DISTANCE` m on, over at least 3 m.

    Args:
        robot: the robot that walks over the boxes.
        part: greatest height of a box, as a fraction of the robot's length.
        seed: seed of the random heights.
    """
    side = max(SIDE * robot.length, LEAST_SIDE)
    pitch = (1 + GAP) * side
    heights = np.random.default_rng(seed).uniform(0.0, part * robot.length, (ALONG, ACROSS))
    ground = Patch.rectangle((0.0, 0.0, 0.0), (2 * REACH, 2 * REACH), name="ground")
    boxes = [
        Patch.rectangle(
            (DISTANCE + (i + 0.5) * pitch, (j + 0.5 - ACROSS / 2) * pitch, height),
            (side, side),
            name=f"box{i}.{j}",
        )
        for (i, j), height in np.ndenumerate(heights)
    ]
    return PiecewiseTerrain(faces=(ground, *boxes))
