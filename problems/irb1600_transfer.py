"""A transfer of the IRB 1600: rest to rest between two tool poses, with least effort or in least time."""

import math

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.problem import Family, Parameter, Problem
from trajopt.robot import Robot, inverse_kinematics_branches
from trajopt.terms import AccelerationCost, MotorTorqueCost
from trajopt_library.robots import irb1600

from . import arms, common
from .arm_transfer import transfer

# Motor torques, with mean squares of about 0.1, and a small weight on accelerations.
EFFORT = (MotorTorqueCost(weight=1.0), AccelerationCost(weight=1e-3))
INTERVALS = 40


def nearest_posture(robot: Robot, position: np.ndarray, tilt: float, near: np.ndarray) -> np.ndarray:
    """The branch (nq,) nearest to ``near`` that brings the tool to ``position`` (3,) m, world.

    The tool points away from the base's axis, turned down by ``tilt`` rad. Raises `InputError` if no posture
    within the limits does.
    """
    heading = math.atan2(position[1], position[0])
    rotation = pin.rpy.rpyToMatrix(0.0, math.pi / 2 + tilt, heading)
    branches = inverse_kinematics_branches(
        robot, {irb1600.TOOL: pin.SE3(rotation, np.asarray(position))}, near=near
    )
    if not branches:
        x, y, z = position
        raise InputError(
            f"the IRB 1600 cannot bring its tool to ({x:g}, {y:g}, {z:g}) m, tilted by {tilt:g} rad",
            "allowed: poses within reach (1.45 m from the base's axis to the wrist) and joint ranges",
        )
    return branches[0].q


def build(
    *,
    goal: str,
    duration: float | None,
    payload: float,
    motor_inertia: float,
    tilt: float,
    **coordinates: float,
) -> Problem:
    """Build the transfer; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = irb1600.build(payload=payload, motor_inertia=motor_inertia)
    first, last = ([coordinates[f"{end}_{axis}"] for axis in "xyz"] for end in ("start", "goal"))
    start = nearest_posture(robot, np.array(first), tilt, robot.reference)
    posture = nearest_posture(robot, np.array(last), tilt, start)
    return transfer(
        "irb1600-transfer",
        robot,
        (start, posture),
        goal=goal,
        duration=duration,
        least=arms.least_duration(robot, (start, posture), weight=False),
        effort=EFFORT,
        intervals=INTERVALS,
        parameters={"start": first, "end": last},
    )


def _place(end: str, *place: float) -> tuple[Parameter, ...]:
    return tuple(
        common.length(f"{end}_{axis}", value, f"{end} of the tool, world {axis}", (-2.0, 2.5))
        for axis, value in zip("xyz", place, strict=True)
    )


FAMILY = Family(
    name="irb1600-transfer",
    robot="irb1600",
    phases=("transfer",),
    summary="bring the tool from one pose to another, from rest to rest, with least effort or in least time",
    parameters=(
        common.choice("goal", "objective: copper losses or time", "effort", "time"),
        common.duration(
            "duration",
            None,
            "duration, with goal=time its guess (default: estimated from the drives)",
            (1e-2, 60.0),
        ),
        common.number("payload", 8.0, "kg", "steel cube on the flange", (0.0, 20.0)),
        common.number(
            "motor_inertia", 0.75, "", "reflected motor inertia over that of the moved bodies", (0.0, 2.0)
        ),
        *_place("start", 0.9, -0.7, 0.5),
        *_place("goal", 0.7, 0.8, 1.1),
        common.angle("tilt", math.pi / 3, "angle of the tool below the horizontal", (-math.pi / 2, math.pi)),
    ),
    build=build,
)
