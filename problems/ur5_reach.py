"""A reach of the UR5: rest to rest to a pose of its tool, with torques, accelerations or rates as inputs."""

import numpy as np
import pinocchio as pin

from trajopt.problem import Family, Problem
from trajopt.robot import inverse_kinematics
from trajopt.terms import ACTUATIONS, AccelerationCost, Actuation, Term, TorqueCost, VelocityCost

from . import arms, common
from .arm_reach import turns

# Costs for each control input.
COSTS: dict[Actuation, tuple[Term, ...]] = {
    "torque": (TorqueCost(weight=1.0), AccelerationCost(weight=1e-2)),
    "acceleration": (AccelerationCost(weight=1.0),),
    "velocity": (VelocityCost(weight=1.0),),
}


def build(
    *, roll: float, pitch: float, yaw: float, duration: float, actuation: Actuation, **given: float
) -> Problem:
    """Build the reach; see ``FAMILY`` for the parameters.

    The guess ends where inverse kinematics from the start posture gets closest to the goal. A goal out of
    reach still gives a problem, whose solution then reports the violated constraint.
    """
    arm = arms.load("ur5")
    robot = arm.robot
    turn, place = pin.rpy.rpyToMatrix(roll, pitch, yaw), np.array([given[axis] for axis in "xyz"])
    goal = pin.SE3(turn @ arm.at_reference.rotation, place)
    end = inverse_kinematics(robot, robot.reference, {arm.tool: goal}).q
    pose, rest = arm.arrival(goal, end)
    return arms.between(
        "ur5-reach",
        robot,
        (robot.reference, end),
        duration,
        phase="reach",
        costs=COSTS[actuation],
        torque_share=given["torque_share"],
        # With velocity inputs the arm can stop at any time.
        end=(pose,) if actuation == "velocity" else (rest, pose),
        actuation=actuation,
        default_intervals=30,
    )


FAMILY = Family(
    name="ur5-reach",
    robot="ur5",
    phases=("reach",),
    summary="bring the tool to a pose, from rest to rest, within torque, velocity and position limits",
    parameters=(
        *(
            common.length(name, default, "goal of the tool, world", (-5.0, 5.0))
            for name, default in (("x", 0.3), ("y", 0.45), ("z", 0.45))
        ),
        *turns("its start orientation"),
        common.duration("duration", 1.5, "duration of the motion", (1e-3, 60.0)),
        common.TORQUE_SHARE,
        common.choice("actuation", "control input of the joints", *ACTUATIONS),
    ),
    build=build,
)
