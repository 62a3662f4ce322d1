"""A Go2 keeps a foot above a moving height, its base low: a constraint and a cost of its own."""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

import trajopt
from trajopt import FlatGround, Phase, Problem, Schedule, terms
from trajopt.robot import Units, contact_poses, contact_targets, inverse_kinematics

LEAN, LIFT = 0.5, 1.0  # s


@dataclass(frozen=True, kw_only=True)
class BaseHeightCost(terms.Cost):
    height: float  # m, to which the base is drawn

    def residual(self, context: terms.Context, units: Units) -> ca.SX:
        return (context.frame("base").position[2] - context.parameter(self.height)) / units.length


@dataclass(frozen=True, kw_only=True)
class FrameAboveHeight(terms.PointConstraint):
    frame: str
    height: Callable[[float], float]  # s -> m, least height of the frame's origin

    def rows(self, context: terms.Context, units: Units) -> terms.Rows:
        height = context.varying(lambda t: np.array([self.height(t)]), 1)
        return terms.Rows.create(context.frame(self.frame).position[2] - height, 0.0, np.inf, units.length)


def least_height(t: float) -> float:
    s = np.clip((t - LEAN) / LIFT, 0.0, 1.0)
    return float(0.02 + 0.13 * np.sin(0.8 * np.pi * s) ** 2)  # from the ground to 0.15 m and halfway back


robot = trajopt.robot("go2")
foot, places = "FR_ball", contact_targets(robot, contact_poses(robot, robot.reference))  # frame: (3,) m
leaning = robot.reference.copy()
leaning[:3] += [-0.03, 0.04, -0.04]  # over the three feet that stay
lifted = inverse_kinematics(robot, leaning, {**places, foot: places[foot] + [0.0, 0.0, 0.12]}).q
lean = Phase(name="lean", duration=LEAN, contacts=("FL", "FR", "RL", "RR"))
lift = Phase(name="lift", duration=LIFT, contacts=("FL", "RL", "RR"))
own = BaseHeightCost(weight=20, height=0.26), FrameAboveHeight(frame=foot, height=least_height, during="lift")
limits = terms.FrictionPyramid(), terms.TorqueLimits(), terms.PositionLimits(), terms.VelocityLimits()
problem = Problem(
    name="own-terms",
    robot=robot,
    schedule=Schedule((lean, lift)),
    terrain=FlatGround(friction=0.7),
    guess=lambda t: robot.reference if t < LEAN else lifted,
    terms=(*own, *terms.effort_costs(), *limits, terms.TerminalRest(q=lifted)),
)

if __name__ == "__main__":
    solution = trajopt.solve(problem)
    print(solution.statistics.status, trajopt.check(solution).failures())
    solution.save("own-terms.npz")
