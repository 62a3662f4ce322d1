"""Half a backflip of Solo12: push, take-off, and a flight that ends with the nose beyond the vertical."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import ORDERS
from trajopt.dynamics.model_quantities import STANDARD_GRAVITY
from trajopt.dynamics.virtual_base import DEFAULT_ORDER
from trajopt.problem.family import Choice, Family
from trajopt.problem.problem import Problem
from trajopt.reduced.base_conversion import with_virtual_base
from trajopt.robot.kinematics import contact_positions, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import (
    EffortLimits,
    FrameHeight,
    FramePose,
    FrictionPyramid,
    PositionLimits,
    SwingClearance,
    Term,
    VelocityLimits,
)
from trajopt.terrain.flat import FlatGround
from trajopt_library import robots
from trajopt_library.robots.solo12 import BASE

from . import common

# In the guess the base rises by this much, m, and turns by this part of the whole, while the feet stand.
RISE = 0.04
GROUND_SHARE = 0.1
# The flight ends with the base this much above its standing height, m: room for a landing on the back.
END_RISE = 0.1


def orientation(pitch: float, yaw: float) -> np.ndarray:
    """Rotation of the base (3, 3): nose up by ``pitch`` rad, then to the left by ``yaw`` rad."""
    turned: np.ndarray = pin.utils.rotate("z", yaw) @ pin.utils.rotate("y", -pitch)
    return turned


class _Guess:
    """A smooth push with the feet held, then a parabola on which the base turns at a constant rate."""

    def __init__(self, robot: Robot, turn: np.ndarray, durations: tuple[float, float]) -> None:
        self.robot, self.durations = robot, durations
        _, flight = durations
        upward = (END_RISE - RISE) / flight + STANDARD_GRAVITY * flight / 2
        # Height (m), pitch and yaw (rad): at take-off, and their rates there.
        self.takeoff = np.array([RISE, *(GROUND_SHARE * turn)])
        self.rates = np.array([upward, *((1 - GROUND_SHARE) * turn / flight)])
        self.feet = contact_positions(robot, robot.reference)

    def __call__(self, t: float) -> np.ndarray:
        stance, _ = self.durations
        if t < stance:
            pose = self._pose(common.hermite(t / stance, stance, 0.0, 0.0, self.takeoff, self.rates))
            return inverse_kinematics(self.robot, pose, self.feet).q
        flown = t - stance
        fall = np.array([STANDARD_GRAVITY * flown**2 / 2, 0.0, 0.0])
        flying = self._pose(self.takeoff + self.rates * flown - fall)
        flying[7:] = self._takeoff_joints()
        return flying

    def _takeoff_joints(self) -> np.ndarray:
        return np.array(inverse_kinematics(self.robot, self._pose(self.takeoff), self.feet).q[7:])

    def _pose(self, moved: np.ndarray) -> np.ndarray:
        height, pitch, yaw = moved
        q = self.robot.reference.copy()
        q[2] += height
        q[3:7] = pin.Quaternion(orientation(pitch, yaw)).coeffs()
        return q


def _terms(robot: Robot, pitch: float, yaw: float, ground: FlatGround) -> tuple[Term, ...]:
    return (
        *common.legged_costs(acceleration=2e-2),
        EffortLimits(),
        PositionLimits(),
        VelocityLimits(),
        FrictionPyramid(friction=ground.friction),
        SwingClearance(height=common.CLEARANCE, terrain=ground),
        FrameHeight(frame=BASE, height=robot.reference[2] + END_RISE, phase="flight", fraction=1.0),
        FramePose(frame=BASE, rotation=orientation(pitch, yaw)),
    )


def build(
    *, pitch: float, yaw: float, duration: float, stance: float, friction: float, base: str, order: str
) -> Problem:
    """Build the flip; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = robots.load("solo12")
    ground = FlatGround(friction=friction)
    feet = tuple(contact.name for contact in robot.contacts)
    phases = (
        Phase(name="stance", duration=stance, contacts=feet),
        Phase(name="flight", duration=duration),
    )
    problem = Problem(
        name="solo12-flip",
        robot=robot,
        schedule=Schedule(phases),
        terrain=ground,
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=_terms(robot, pitch, yaw, ground),
        guess=_Guess(robot, np.array([pitch, yaw]), (stance, duration)),
    )
    return with_virtual_base(problem, order) if base == "virtual" else problem


FAMILY = Family(
    name="solo12-flip",
    robot="solo12",
    phases=("stance", "flight"),
    summary="half a backflip: take off and fly until the nose is beyond the vertical",
    parameters=(
        common.angle("pitch", math.radians(110), "nose up at the end of the flight", (0.0, math.pi)),
        common.yaw(0.5),
        common.duration("duration", 0.4, "duration of the flight", (0.1, 2.0)),
        common.duration("stance", 0.4, "duration of the push", (1e-3, 10.0)),
        common.friction(0.7),
        Choice(
            name="base",
            default="freeflyer",
            choices=("freeflyer", "virtual"),
            meaning="a quaternion, or six virtual joints, which have a gimbal lock",
        ),
        Choice(
            name="order",
            default=DEFAULT_ORDER,
            choices=ORDERS,
            meaning="axes of the virtual angles, the outer one first",
        ),
    ),
    build=build,
)
