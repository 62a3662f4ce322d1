"""What families share: parameters, guesses along a joint path, a hop's schedule, costs, a wall's normal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trajopt.problem.family import Choice, Parameter
from trajopt.reduced.base_path import hermite as hermite
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import EffortLimits, FrictionPyramid, SoleCone, Term, effort_costs
from trajopt.terrain.swing_profile import smooth_step

# Least height of a foot over the ground in mid flight, m.
CLEARANCE = 0.03

Range = tuple[float, float]


def duration(name: str, default: float | None, meaning: str, within: Range) -> Parameter:
    """A time, s, within bounds."""
    return Parameter(name=name, default=default, unit="s", lower=within[0], upper=within[1], meaning=meaning)


def length(name: str, default: float | None, meaning: str, within: Range) -> Parameter:
    """A distance or a coordinate, m, within bounds."""
    return Parameter(name=name, default=default, unit="m", lower=within[0], upper=within[1], meaning=meaning)


def angle(name: str, default: float | None, meaning: str, within: Range) -> Parameter:
    """An angle, rad, within bounds."""
    return Parameter(
        name=name, default=default, unit="rad", lower=within[0], upper=within[1], meaning=meaning
    )


def yaw(default: float) -> Parameter:
    """A turn of the base, rad."""
    return angle("yaw", default, "turn to the left", (-math.pi / 2, math.pi / 2))


def friction(default: float, name: str = "friction", meaning: str = "Coulomb coefficient") -> Parameter:
    """A coefficient of friction."""
    return Parameter(name=name, default=default, unit="", lower=0.0, upper=10.0, meaning=meaning)


def effort() -> Parameter:
    """One torque limit for all joints, N m."""
    meaning = "torque limit (default: the URDF's)"
    return Parameter(name="effort", default=None, unit="N m", lower=0.0, upper=1e4, meaning=meaning)


def effort_share() -> Parameter:
    """A part of the robot's own torque limits."""
    meaning = "share of the effort limits to use"
    return Parameter(name="effort_share", default=1.0, unit="", lower=1e-3, upper=1.0, meaning=meaning)


def touchdown() -> Choice:
    """How contacts land: `hop_schedule` takes ``impact``, and impulses want a price of their own."""
    meaning = "land at zero foot velocity or by a rigid impact"
    return Choice(name="touchdown", default="soft", choices=("soft", "impact"), meaning=meaning)


def goal(*choices: str) -> Choice:
    """What the motion minimises or maximises: names of `trajopt.terms.objectives`, the first the default."""
    return Choice(name="goal", default=choices[0], choices=choices, meaning="what is best")


@dataclass(frozen=True)
class JointPath:
    """Guess: from ``start`` to ``end`` (nq,) along 10 s^3 - 15 s^4 + 6 s^5 in ``duration`` s, then still.

    For configurations that are vectors: a fixed base and no continuous joints.
    """

    start: np.ndarray
    end: np.ndarray
    duration: float

    def __call__(self, t: float) -> np.ndarray:
        return self.start + smooth_step(t / self.duration) * (self.end - self.start)


def hop_schedule(
    footholds: Mapping[str, np.ndarray], durations: tuple[float, float, float], *, impact: bool = False
) -> Schedule:
    """Stance, flight and landing: contacts leave together and land on ``footholds`` (3,) m, world."""
    contacts = tuple(footholds)
    stance, flight, landing = durations
    return Schedule(
        (
            Phase(name="stance", duration=stance, contacts=contacts),
            Phase(name="flight", duration=flight),
            Phase(name="landing", duration=landing, contacts=contacts, footholds=footholds, impact=impact),
        )
    )


def legged_costs(*, acceleration: float, joints_only: bool = False) -> tuple[Term, ...]:
    """Torques, and little for all else, so that no direction of a legged motion is left without a price.

    acceleration: weight of accelerations. joints_only: leave those and rates of the base out.
    """
    return effort_costs(acceleration=acceleration, joints_only=joints_only)


def contact_cones(robot: Robot) -> tuple[Term, ...]:
    """Forces of points within pyramids of friction, wrenches of soles within what their surfaces transmit."""
    kinds = {contact.kind for contact in robot.contacts}
    points: tuple[Term, ...] = (FrictionPyramid(),) if "point" in kinds else ()
    return (*points, SoleCone()) if "surface" in kinds else points


def share_of_effort(robot: Robot, share: float) -> EffortLimits:
    """Torques within a share of the robot's limits; a robot without limits stays without."""
    return EffortLimits(limit=None if robot.effort_limit is None else share * robot.effort_limit)


def wall_normal(tilt: float) -> np.ndarray:
    """Normal (3,) of a wall ahead, towards the robot; a positive ``tilt`` rad turns the wall's top away."""
    return np.array([-math.cos(tilt), 0.0, math.sin(tilt)])
