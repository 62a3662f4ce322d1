"""A hop of the planar hopper, in minimal coordinates of each phase or as one floating-base system."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import robots
from robots.hopper import FOOT
from trajopt.family import Choice, Family, Parameter
from trajopt.kinematics import inverse_kinematics
from trajopt.mode import Mode
from trajopt.model_quantities import STANDARD_GRAVITY
from trajopt.node_terms import SwingClearance, TerminalRest, TerminalState
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.schedule import FlatGround, Phase, Schedule
from trajopt.terms import (
    AccelerationCost,
    EffortLimits,
    FrictionCone,
    ImpulseCost,
    PositionLimits,
    PostureCost,
    Term,
    TorqueCost,
    VelocityCost,
    VelocityLimits,
    WrenchCost,
)

# The base rises by this much while the leg stretches, m, in the guess.
RISE = 0.1
# Least height of the foot in mid flight, m.
CLEARANCE = 0.03


class _Guess:
    """Crouch, stretch, a parabola, and back to the standing posture, the foot where it belongs."""

    def __init__(self, robot: Robot, distance: float, durations: tuple[float, float, float]) -> None:
        self.robot, self.distance, self.durations = robot, distance, durations
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, robot.reference)
        self.foot = data.oMf[robot.model.getFrameId(FOOT)].translation.copy()

    def __call__(self, t: float) -> np.ndarray:
        stance, flight, landing = self.durations
        q = self.robot.reference.copy()
        s = min(max((t - stance) / flight, 0.0), 1.0)
        if t < stance:
            rise = RISE * _smooth(t / stance)
        elif t > stance + flight:
            rise = RISE * _smooth(1 - (t - stance - flight) / landing)
        else:
            rise = RISE + STANDARD_GRAVITY * flight**2 * s * (1 - s) / 2
        step = np.array([self.distance * s, 0.0, 0.0])
        q[:2] += [step[0], rise]
        lift = CLEARANCE * 4 * s * (1 - s) + STANDARD_GRAVITY * flight**2 * s * (1 - s) / 2
        return inverse_kinematics(self.robot, q, {FOOT: self.foot + step + np.array([0.0, 0.0, lift])}).q


def _smooth(s: float) -> float:
    s = min(max(s, 0.0), 1.0)
    return s * s * (3 - 2 * s)


def _terms(robot: Robot, end: np.ndarray, ground: FlatGround, impact: bool) -> tuple[Term, ...]:
    """Costs that mean the same in every choice of coordinates: torques, joint angles, contact forces."""
    soft: tuple[Term, ...] = (ImpulseCost(weight=1e-1),) if impact else ()
    return (
        TorqueCost(weight=1.0),
        AccelerationCost(weight=1e-2, joints_only=True),
        VelocityCost(weight=1e-2, joints_only=True),
        PostureCost(weight=1e-1),
        WrenchCost(weight=1e-2),
        *soft,
        EffortLimits(),
        PositionLimits(),
        VelocityLimits(),
        FrictionCone(),
        SwingClearance(height=CLEARANCE, terrain=ground),
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
    guess = _Guess(robot, distance, (stance, flight, landing))
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
        schedule=Schedule(
            (
                Phase(name="stance", duration=stance, contacts=(FOOT,)),
                Phase(name="flight", duration=flight),
                Phase(
                    name="landing",
                    duration=landing,
                    contacts=(FOOT,),
                    footholds={FOOT: target},
                    impact=impact,
                ),
            )
        ),
        terrain=ground,
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=_terms(robot, end, ground, impact),
        guess=guess,
        modes=modes,
    )


def _duration(name: str, default: float, meaning: str) -> Parameter:
    return Parameter(name=name, default=default, unit="s", lower=1e-2, upper=5.0, meaning=meaning)


FAMILY = Family(
    name="hopper-hop",
    robot="hopper",
    phases=("stance", "flight", "landing"),
    summary="hop of the planar hopper onto a foothold and to rest, in minimal or excess coordinates",
    parameters=(
        Parameter(
            name="distance", default=0.2, unit="m", lower=-0.6, upper=0.6, meaning="forward displacement"
        ),
        _duration("stance", 0.4, "duration of the push"),
        _duration("flight", 0.3, "duration of the flight"),
        _duration("landing", 0.5, "duration from touchdown to rest"),
        Parameter(
            name="friction", default=0.7, unit="", lower=0.0, upper=10.0, meaning="Coulomb coefficient"
        ),
        Choice(
            name="coordinates",
            default="excess",
            choices=("excess", "minimal"),
            meaning="one floating base with contact rows, or a model for each phase",
        ),
        Choice(
            name="touchdown",
            default="soft",
            choices=("soft", "impact"),
            meaning="land at zero foot velocity or by a rigid impact",
        ),
    ),
    build=build,
)
