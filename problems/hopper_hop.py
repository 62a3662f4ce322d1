"""A hop of the planar hopper, in minimal coordinates of each phase or as one floating-base system."""

from __future__ import annotations

import numpy as np

import robots
from problems import common
from robots.hopper import FOOT
from trajopt.family import Choice, Family
from trajopt.kinematics import contact_positions, inverse_kinematics
from trajopt.mode import Mode
from trajopt.model_quantities import STANDARD_GRAVITY
from trajopt.node_terms import SwingClearance, TerminalRest, TerminalState
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.schedule import FlatGround
from trajopt.terms import EffortLimits, FrictionCone, ImpulseCost, PositionLimits, Term, VelocityLimits

# The base rises by this much while the leg stretches, m, in the guess.
RISE = 0.1


class _Guess:
    """Crouch, stretch, a parabola, and back to the standing posture, the foot where it belongs."""

    def __init__(self, robot: Robot, distance: float, durations: tuple[float, float, float]) -> None:
        self.robot, self.distance, self.durations = robot, distance, durations
        self.foot = contact_positions(robot, robot.reference)[FOOT]

    def __call__(self, t: float) -> np.ndarray:
        stance, flight, landing = self.durations
        q = self.robot.reference.copy()
        s = min(max((t - stance) / flight, 0.0), 1.0)
        if t < stance:
            rise = float(common.hermite(t / stance, stance, 0.0, 0.0, RISE, 0.0))
        elif t > stance + flight:
            rise = float(common.hermite((t - stance - flight) / landing, landing, RISE, 0.0, 0.0, 0.0))
        else:
            rise = RISE + STANDARD_GRAVITY * flight**2 * s * (1 - s) / 2
        step = np.array([self.distance * s, 0.0, 0.0])
        q[:2] += [step[0], rise]
        lift = common.CLEARANCE * 4 * s * (1 - s) + STANDARD_GRAVITY * flight**2 * s * (1 - s) / 2
        return inverse_kinematics(self.robot, q, {FOOT: self.foot + step + np.array([0.0, 0.0, lift])}).q


def _terms(end: np.ndarray, ground: FlatGround, impact: bool) -> tuple[Term, ...]:
    """Costs that mean the same in every choice of coordinates: torques, joint angles, contact forces."""
    soft: tuple[Term, ...] = (ImpulseCost(weight=1e-1),) if impact else ()
    return (
        *common.legged_costs(acceleration=1e-2, joints_only=True),
        *soft,
        EffortLimits(),
        PositionLimits(),
        VelocityLimits(),
        FrictionCone(),
        SwingClearance(height=common.CLEARANCE, terrain=ground),
        TerminalState(q=end),
        TerminalRest(q=end),
    )


def build(
    *,
    distance: float,
    stance: float,
    flight: float,
    landing: float,
    friction: float,
    coordinates: str,
    touchdown: str,
) -> Problem:
    """Build the hop; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = robots.load("hopper")
    durations = (stance, flight, landing)
    guess = _Guess(robot, distance, durations)
    target = guess.foot + np.array([distance, 0.0, 0.0])
    end = robot.reference.copy()
    end[0] += distance
    ground = FlatGround(friction=friction)
    impact = touchdown == "impact"
    modes = {}
    if coordinates == "minimal":
        modes = {
            "stance": Mode.standing(robot, FOOT, guess.foot),
            "landing": Mode.standing(robot, FOOT, target),
        }
    return Problem(
        name="hopper-hop",
        robot=robot,
        schedule=common.hop_schedule({FOOT: target}, durations, impact=impact),
        terrain=ground,
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=_terms(end, ground, impact),
        guess=guess,
        modes=modes,
    )


FAMILY = Family(
    name="hopper-hop",
    robot="hopper",
    phases=("stance", "flight", "landing"),
    summary="hop of the planar hopper onto a foothold and to rest, in minimal or excess coordinates",
    parameters=(
        common.length("distance", 0.2, "forward displacement", (-0.6, 0.6)),
        common.duration("stance", 0.4, "duration of the push", (1e-2, 5.0)),
        common.duration("flight", 0.3, "duration of the flight", (1e-2, 5.0)),
        common.duration("landing", 0.5, "duration from touchdown to rest", (1e-2, 5.0)),
        common.friction(0.7),
        Choice(
            name="coordinates",
            default="excess",
            choices=("excess", "minimal"),
            meaning="one floating base with contact rows, or a model for each phase",
        ),
        common.touchdown(),
    ),
    build=build,
)
