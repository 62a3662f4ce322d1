"""Half a backflip of Solo12: push, take-off, and a flight that ends with the nose beyond the vertical."""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics import ORDERS, STANDARD_GRAVITY
from trajopt.problem import Family, Problem
from trajopt.reduced import with_virtual_base
from trajopt.robot import Robot, contact_positions, inverse_kinematics
from trajopt.schedule import Motion, end_of
from trajopt.terms import FrameHeight, FramePose
from trajopt_library import robots
from trajopt_library.robots.solo12 import BASE

from . import common, leaping

# Rise of the base, m, and fraction of the whole turn, in the guess while the feet stand.
RISE = 0.04
GROUND_SHARE = 0.1
# Height of the base above standing at the end of the flight, m: room for a landing on the back.
END_RISE = 0.1


def orientation(pitch: float, yaw: float) -> np.ndarray:
    """Rotation of the base (3, 3): nose up by ``pitch`` rad, then to the left by ``yaw`` rad."""
    turned: np.ndarray = pin.utils.rotate("z", yaw) @ pin.utils.rotate("y", -pitch)
    return turned


def _guess(robot: Robot, turn: np.ndarray, stance: float, flight: float) -> Motion:
    """Return the guess: a smooth push with fixed feet, then a parabola with a constant rate of turning.

    turn: final pitch and yaw (2,), rad.
    """
    # Height (m), pitch and yaw (rad) at take-off, and their rates there.
    takeoff = np.array([RISE, *(GROUND_SHARE * turn)])
    upward = (END_RISE - RISE) / flight + STANDARD_GRAVITY * flight / 2
    rates = np.array([upward, *((1 - GROUND_SHARE) * turn / flight)])

    joints = _standing(robot, takeoff)[7:]
    return _Flip(robot=robot, stance=stance, takeoff=takeoff, rates=rates, joints=joints)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Flip:
    """Guess: ``takeoff`` and ``rates`` (3,) of height m, pitch and yaw rad; ``joints`` (12,) in flight."""

    robot: Robot
    stance: float
    takeoff: np.ndarray
    rates: np.ndarray
    joints: np.ndarray

    def __call__(self, t: float) -> np.ndarray:
        if t < self.stance:
            moved = common.hermite(t / self.stance, self.stance, 0.0, 0.0, self.takeoff, self.rates)
            return _standing(self.robot, moved)
        flown = t - self.stance
        fallen = np.array([STANDARD_GRAVITY * flown**2 / 2, 0.0, 0.0])
        flying = _pose(self.robot, self.takeoff + self.rates * flown - fallen)
        flying[7:] = self.joints
        return flying


def _pose(robot: Robot, moved: np.ndarray) -> np.ndarray:
    q = common.displaced(robot, (0.0, 0.0, moved[0]))
    q[3:7] = pin.Quaternion(orientation(*moved[1:])).coeffs()
    return q


def _standing(robot: Robot, moved: np.ndarray) -> np.ndarray:
    feet = contact_positions(robot, robot.reference)
    return inverse_kinematics(robot, _pose(robot, moved), feet).q


def build(
    *, pitch: float, yaw: float, duration: float, stance: float, friction: float, base: str, order: str
) -> Problem:
    """Build the flip; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = robots.load("solo12")
    feet = tuple(contact.name for contact in robot.contacts)
    top = robot.reference[2] + END_RISE
    problem = common.problem(
        "solo12-flip",
        robot,
        common.schedule_of({"stance": stance, "flight": duration}, (feet, ())),
        _guess(robot, np.array([pitch, yaw]), stance, duration),
        costs=leaping.COSTS,
        friction=friction,
        clearance=common.CLEARANCE,
        end=(
            FrameHeight(frame=BASE, height=top, at=end_of("flight")),
            FramePose(frame=BASE, rotation=orientation(pitch, yaw)),
        ),
    )
    return with_virtual_base(problem, order) if base == "virtual" else problem


FAMILY = Family(
    name="solo12-flip",
    robot="solo12",
    phases=("stance", "flight"),
    summary="half a backflip: take off and fly until the nose is beyond the vertical",
    parameters=(
        common.angle("pitch", math.radians(110), "nose up at the end of the flight", (0.0, math.pi)),
        common.angle("yaw", 0.5, "turn to the left", (-math.pi / 2, math.pi / 2)),
        common.duration("duration", 0.4, "duration of the flight", (0.1, 2.0)),
        common.duration("stance", 0.4, "duration of the push", (1e-3, 10.0)),
        common.friction(0.7),
        common.choice(
            "base", "a quaternion, or six virtual joints, which have a gimbal lock", "freeflyer", "virtual"
        ),
        common.choice("order", "axes of the virtual angles, the outer one first", *ORDERS),
    ),
    build=build,
)
