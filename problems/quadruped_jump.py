"""Jumps of quadrupeds from level ground to level ground: up, forward, sideways and turning."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Literal

from trajopt.problem import Family, Problem
from trajopt.robot import Robot, Units
from trajopt.schedule import middle_of
from trajopt.terms import Actuation, FrameHeight
from trajopt.terrain import FlatGround

from . import common, leaping, pushing

ROBOTS = ("solo12", "go2", "anymal_c", "a1", "hyq")
# Default durations in units of sqrt(l / g); solo12 pushes for 0.4 s and comes to rest in 0.5 s.
STANCE, LANDING = 2.7, 3.4
# Limits of the default rise of the base and displacements forward and to the left, over the robot's length,
# and of the turn, rad; less if joints are too slow.
HEIGHT, LEAST_HEIGHT, FORWARD, SIDEWAYS, TURN = 0.75, 0.4, 1.0, 0.5, math.pi / 2
# Shares of the largest take-off speeds: upwards in a jump up, upwards in other jumps, across and turning.
SHARE_UP, SHARE_LOW, SHARE_ACROSS = 0.75, 0.6, 0.25
# Motions with free durations are faster and need more intervals to limit the drift of the feet.
INTERVALS = {"effort": 50, "time": 80}

# Directions of a jump.
Direction = Literal["up", "forward", "sideways", "turn"]


def _defaults(takeoff: pushing.Takeoff, direction: Direction, height: float | None) -> dict[str, float]:
    """Return the defaults of a jump from the robot's length, within its possible take-off speeds."""
    length = takeoff.robot.length
    high = direction in ("up", "turn")
    share, most = (SHARE_UP, HEIGHT) if direction == "up" else (SHARE_LOW, HEIGHT if high else LEAST_HEIGHT)
    rise = pushing.apex(takeoff, share, most * length) if height is None else height
    flight = pushing.flight_time(takeoff, rise)
    forward, left = (SHARE_ACROSS * speed * flight for speed in takeoff.across)
    turn = SHARE_ACROSS * takeoff.turn * flight
    unit = Units(takeoff.robot).time
    return {
        "distance": min(FORWARD * length, forward) if direction == "forward" else 0.0,
        "sideways": min(SIDEWAYS * length, left) if direction == "sideways" else 0.0,
        "yaw": min(TURN, turn) if direction == "turn" else 0.0,
        "height": rise,
        "flight": flight,
        "stance": STANCE * unit,
        "landing": LANDING * unit,
    }


def build(
    *,
    robot: str,
    friction: float,
    torque_limit: float | None,
    goal: str,
    direction: Direction,
    kind: str = "quadruped",
    load: Callable[[str], Robot] = common.quadruped,
    actuation: Actuation = "torque",
    **given: float | None,
) -> Problem:
    """Build the jump; see ``FAMILIES`` for the parameters. Raises InputError.

    ``load`` returns the robot of a name, or raises if it is not of that ``kind``.
    """
    body = load(robot)
    takeoff = pushing.takeoff(body, torque_limit)
    values = common.filled(_defaults(takeoff, direction, given["height"]), given)
    end = common.displaced(body, (values["distance"], values["sideways"], 0.0), values["yaw"])
    top = body.reference[2] + values["height"]
    return leaping.problem(
        f"{kind}-jump-{direction}",
        takeoff,
        (body.reference, end),
        (values["stance"], values["flight"], values["landing"]),
        terrain=FlatGround(friction=friction),
        torque_limit=torque_limit,
        turn=values["yaw"],
        goal=goal,
        actuation=actuation,
        more=(FrameHeight(frame=body.model.names[1], height=top, at=middle_of("flight")),),
        parameters=values,
        default_intervals=INTERVALS[goal],
    )


def family(
    direction: Direction,
    summary: str,
    *,
    kind: str = "quadruped",
    robots: tuple[str, ...] = ROBOTS,
    load: Callable[[str], Robot] = common.quadruped,
    variants: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
) -> Family:
    """The family of jumps in a direction, on robots of a kind."""
    return Family(
        name=f"{kind}-jump-{direction}",
        robots=robots,
        phases=("stance", "flight", "landing"),
        summary=summary,
        parameters=(
            common.length("distance", None, "forward displacement", (-5.0, 5.0)),
            common.length("sideways", None, "displacement to the left", (-5.0, 5.0)),
            common.length("height", None, "least rise of the base over standing in mid flight", (0.0, 5.0)),
            common.angle("yaw", None, "turn to the left", (-math.pi, math.pi)),
            *common.hop_durations("from the height"),
            common.friction(0.7),
            common.TORQUE_LIMIT,
            common.goal("effort", "time"),
            common.ACTUATION,
        ),
        build=partial(build, direction=direction, kind=kind, load=load),
        variants=variants,
    )


FAMILIES = (
    family("up", "jump straight up, land on the same places and come to rest"),
    family("forward", "jump forward from stance to stance", variants={"actuation=jerk": ROBOTS}),
    family("sideways", "jump to the left from stance to stance"),
    family("turn", "jump up and turn to the left in flight"),
)
