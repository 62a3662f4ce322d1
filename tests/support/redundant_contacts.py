"""Robots whose contact rows depend on each other: parallel legs, a foot of four corners."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin

from tests.support.problems import hop
from trajopt import Contact, FlatGround, Phase, Problem, Robot, Schedule, terms
from trajopt.robot.data import robot_file

LEGS = ("FL", "FR", "HL", "HR")


@lru_cache
def solo() -> Robot:
    """Solo with eight joints: its legs move in parallel planes, so that its feet fix each other sideways."""
    bent = {"HFE": 0.8, "KFE": -1.6}
    sides = {leg: 1 if leg.startswith("F") else -1 for leg in LEGS}
    return Robot.from_urdf(
        robot_file("solo_description/robots/solo.urdf"),
        name="solo",
        contacts=[f"{leg}_FOOT" for leg in LEGS],
        reference={
            f"{leg}_{joint}": side * angle for leg, side in sides.items() for joint, angle in bent.items()
        },
    )


def solo_hop() -> Problem:
    robot, ground = solo(), FlatGround(friction=0.7)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    feet = {c.name: data.oMf[robot.model.getFrameId(c.frame)].translation.copy() for c in robot.contacts}
    stance, flight, landing = 0.3, 0.2, 0.4

    def guess(t: float) -> np.ndarray:
        q, s = robot.reference.copy(), t - stance
        q[2] += max(0.0, 9.81 * s * (flight - s) / 2)
        return q

    return Problem(
        name="solo-hop",
        robot=robot,
        schedule=Schedule(
            (
                Phase(name="stance", duration=stance, contacts=tuple(feet)),
                Phase(name="flight", duration=flight),
                Phase(name="landing", duration=landing, contacts=tuple(feet), footholds=feet),
            )
        ),
        terrain=ground,
        terms=(
            terms.TorqueCost(weight=1.0),
            terms.AccelerationCost(weight=2e-2),
            terms.VelocityCost(weight=1e-2),
            terms.PostureCost(weight=1e-1),
            terms.WrenchCost(weight=1e-2),
            terms.PositionLimits(),
            terms.FrictionCone(),
            terms.SwingClearance(height=0.02, terrain=ground),
            terms.TerminalState(q=robot.reference),
            terms.TerminalRest(q=robot.reference),
        ),
        guess=guess,
    )


def corners() -> Robot:
    """The hopper with a foot of four corners instead of a sole: twelve rows of rank six."""
    sole = hop("surface").robot
    model = sole.model.copy()
    foot = model.frames[model.getFrameId("foot")]
    names = []
    for x in (-0.08, 0.08):
        for y in (-0.05, 0.05):
            names.append(f"corner{len(names)}")
            place = foot.placement * pin.SE3(np.eye(3), np.array([x, y, 0.0]))
            model.addFrame(pin.Frame(names[-1], foot.parentJoint, 0, place, pin.FrameType.OP_FRAME))
    return replace(sole, model=model, contacts=tuple(Contact(frame=name) for name in names))
