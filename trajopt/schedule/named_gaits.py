"""Gaits that have a name, on the feet of a quadruped, a biped and a hopper.

Offsets are the definitions of the gaits: Hildebrand, "Symmetrical gaits of horses", Science 150 (1965), and
"Analysis of asymmetrical gaits", J. Mammalogy 58 (1977); Alexander, "The gaits of bipedal and quadrupedal
animals", Int. J. Robotics Research 3 (1984). Animals vary their duty factors with speed, above 1/2 in walks
and below in runs; those here are round values in the middle of their ranges, `Gait.with_duty` changes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from trajopt.arguments import checked
from trajopt.errors import InputError, not_among
from trajopt.robot.legs import biped_legs, feet_in_base, quadruped_legs
from trajopt.robot.robot import Robot
from trajopt.schedule.gaits import Gait


def _quadruped(name: str, duty: float, hind: tuple[float, float], front: tuple[float, float]) -> Gait:
    """Offsets are those of the left and the right foot."""
    return Gait(
        name=name,
        duty=duty,
        offsets={
            "front_left": front[0],
            "front_right": front[1],
            "hind_left": hind[0],
            "hind_right": hind[1],
        },
    )


def _by_name(*gaits: Gait) -> Mapping[str, Gait]:
    return MappingProxyType({gait.name: gait for gait in gaits})


QUADRUPED = _by_name(
    # Symmetrical: left and right half a period apart, the fore foot lags the hind foot of its side.
    _quadruped("walk", 0.65, hind=(0.0, 0.5), front=(0.25, 0.75)),  # lateral sequence, three or two feet
    _quadruped("amble", 0.4, hind=(0.0, 0.5), front=(0.25, 0.75)),  # footfalls of the walk, as a run
    _quadruped("trot", 0.5, hind=(0.0, 0.5), front=(0.5, 0.0)),  # diagonal pairs
    _quadruped("flying-trot", 0.4, hind=(0.0, 0.5), front=(0.5, 0.0)),
    _quadruped("pace", 0.5, hind=(0.0, 0.5), front=(0.0, 0.5)),  # lateral pairs
    # Asymmetrical: both hind feet, then both fore feet.
    _quadruped("bound", 0.4, hind=(0.0, 0.0), front=(0.5, 0.5)),
    _quadruped("pronk", 0.6, hind=(0.0, 0.0), front=(0.0, 0.0)),
    _quadruped("gallop", 0.3, hind=(0.0, 0.1), front=(0.5, 0.6)),  # transverse: fore feet as the hind feet
    _quadruped("rotary-gallop", 0.3, hind=(0.0, 0.1), front=(0.6, 0.5)),  # footfalls go around the body
    _quadruped("canter", 0.4, hind=(0.25, 0.0), front=(0.5, 0.25)),  # three beats, left lead
)

BIPED = _by_name(
    Gait(name="walk", duty=0.6, offsets={"left": 0.0, "right": 0.5}),
    Gait(name="run", duty=0.35, offsets={"left": 0.0, "right": 0.5}),
)

HOPPER = _by_name(Gait(name="hop", duty=0.5, offsets={"foot": 0.0}))


@checked
def gait_of(robot: Robot, name: str) -> Gait:
    """The gait of that name on the feet of a robot: a quadruped, a biped or a hopper.

    Raises `InputError` for another number of feet, or a name that is not a gait for that number of feet.
    """
    feet = feet_in_base(robot)
    if len(feet) == 4:
        return _choose(QUADRUPED, name).on(quadruped_legs(robot).by_role)
    if len(feet) == 2:
        return _choose(BIPED, name).on(dict(zip(("left", "right"), biped_legs(robot), strict=True)))
    if len(feet) == 1:
        return _choose(HOPPER, name).on({"foot": next(iter(feet))})
    raise InputError(f"robot '{robot.name}' has {len(feet)} feet", "allowed: 1, 2 or 4 for a named gait")


def _choose(gaits: Mapping[str, Gait], name: str) -> Gait:
    if name not in gaits:
        raise not_among(gaits, name, f"gait '{name}' is unknown")
    return gaits[name]
