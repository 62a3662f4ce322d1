"""A biped walks: weight shift, steps with a smooth swing and double support between, rest with feet level.

The guess is the walk of the linear inverted pendulum over the same footsteps.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin

import robots
from problems import common
from robots.talos import SIDES
from trajopt.errors import InputError
from trajopt.family import Family, Parameter
from trajopt.model_quantities import gravity_of
from trajopt.node_terms import SwingClearance, TerminalRest
from trajopt.problem import Motion, Problem
from trajopt.reduced.com_program import CenterOfMassProgram
from trajopt.reduced.foot_motion import guess_from_lip
from trajopt.reduced.footsteps import FootstepPlan, Walk
from trajopt.reduced.lip import Pendulum
from trajopt.robot import Robot
from trajopt.schedule import FlatGround
from trajopt.terms import EffortLimits, PositionLimits, SoleCone, Term, VelocityLimits

# Part of the soles that the pendulum's ZMP keeps away from: the robot is no pendulum.
MARGIN = 0.5
# Swings of the guess rise this much higher than they must.
GUESS_SWING = 1.5
INTERVALS_PER_SECOND = 10
# Of every part of the walk, s.
DURATIONS = (0.05, 5.0)


@lru_cache(maxsize=1)
def talos_legs() -> Robot:
    """Talos on its two soles, everything above the legs locked: 12 joints, the mass of the whole robot."""
    whole = robots.load("talos")
    upper = [name for name in whole.model.names if name.startswith("arm_")]
    soles = tuple(whole.contact(side) for side in SIDES)
    return replace(replace(whole, contacts=soles).with_locked(upper), name="talos-legs")


def _guess(robot: Robot, plan: FootstepPlan, clearance: float) -> Motion:
    com = pin.centerOfMass(robot.model, robot.model.createData(), robot.reference)
    program = CenterOfMassProgram(
        robot=robot,
        plan=plan,
        pendulum=Pendulum(height=com[2], gravity=gravity_of(robot.model)),
        com_start=com[:2],
        shrink=MARGIN,
    )
    return guess_from_lip(robot, plan, program.solve(), clearance=GUESS_SWING * clearance)


def _terms(clearance: float, ground: FlatGround, end: np.ndarray, effort: EffortLimits) -> tuple[Term, ...]:
    return (
        *common.legged_costs(acceleration=1e-2),
        effort,
        PositionLimits(),
        VelocityLimits(),
        SoleCone(),
        SwingClearance(height=clearance, terrain=ground),
        TerminalRest(q=end),
    )


def build(
    *,
    steps: float,
    length: float,
    turn: float,
    step_time: float,
    double_support: float,
    shift: float,
    settle: float,
    clearance: float,
    friction: float,
    effort_share: float,
) -> Problem:
    """Build the walk; see ``FAMILY`` for the parameters. Raises InputError."""
    if steps != round(steps):
        raise InputError(f"parameter steps is {steps:g}", "allowed: a whole number")
    robot = talos_legs()
    walk = Walk(
        steps=round(steps),
        length=length,
        turn=turn,
        step_time=step_time,
        double_support=double_support,
        shift_time=shift,
        settle_time=settle,
    )
    plan, ground = walk.plan(robot), FlatGround(friction=friction)
    guess = _guess(robot, plan, clearance)
    return Problem(
        name="biped-walk",
        robot=robot,
        schedule=plan.schedule(),
        terrain=ground,
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=_terms(clearance, ground, guess(plan.duration), common.share_of_effort(robot, effort_share)),
        guess=guess,
        parameters={
            "steps": walk.steps,
            "length": length,
            "turn": turn,
            "step_time": step_time,
            "double_support": double_support,
            "shift": shift,
            "settle": settle,
            "clearance": clearance,
            "friction": friction,
            "effort_share": effort_share,
        },
        default_intervals=max(len(plan.supports), math.ceil(INTERVALS_PER_SECOND * plan.duration)),
    )


FAMILY = Family(
    name="biped-walk",
    robot="talos",
    phases=("shift", "step_1", "double_1", "step_2", "...", "settle"),
    summary="walk some steps on two soles, the last of which brings the feet side by side, and come to rest",
    parameters=(
        Parameter(name="steps", default=4, unit="", lower=2, upper=20, meaning="number of steps"),
        common.length("length", 0.2, "from one step to the next", (-0.4, 0.4)),
        common.angle("turn", 0.0, "to the left from one step to the next", (-0.4, 0.4)),
        common.duration("step_time", 0.6, "duration of a swing", DURATIONS),
        common.duration(
            "double_support", 0.15, "duration of both feet on the ground between steps", DURATIONS
        ),
        common.duration("shift", 0.5, "duration from rest to the first step", DURATIONS),
        common.duration("settle", 0.6, "duration from the last touchdown to rest", DURATIONS),
        common.length("clearance", 0.04, "least height of a sole in mid swing", (0.0, 0.2)),
        common.friction(0.7),
        common.effort_share(),
    ),
    build=build,
)
