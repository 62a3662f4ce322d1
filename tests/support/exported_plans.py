"""Plans to export, each solved once: a gait that turns, one that is mirrored, an arm, an impact."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import trajopt
from tests.support.sampled_problems import solution_of_kind
from tests.support.solved_problems import motion
from tests.support.synthetic_motions import arm_motion, sampled
from trajopt.motion.solution import Solution
from trajopt.robot.robot import Robot
from trajopt.simulation.mjcf import mjcf_of

# Two ways through rigid-body kinematics in double precision, and images of images.
ROUNDING = 1e-9
# The same in single precision: six digits of metres and radians, some of them added up by readers.
SINGLE = 2e-6

GAITS = {
    "turning trot": ("quadruped-trot", {"robot": "solo12", "turn_rate": 0.8}),
    "mirrored walk": ("biped-gait", {"robot": "g1"}),
    "planar hops": ("hopper-gait", {}),
}


@lru_cache
def plan_to_export(kind: str) -> Solution:
    """One of ``GAITS``, or an arm, or an impact."""
    if kind in GAITS:
        name, settings = GAITS[kind]
        return motion(name, **settings)
    return solution_of_kind({"an arm": "torque", "an impact": "an impact"}[kind])


KINDS = (*GAITS, "an arm", "an impact")


def swinging_arm(locked: tuple[str, ...] = ()) -> Solution:
    """A UR5 on sines, without a solve."""
    robot: Robot = trajopt.robot("ur5")
    robot = robot.with_locked(locked) if locked else robot
    return sampled(robot, [arm_motion(robot)], 4)


def resting_arm(duration: float, **meta: Any) -> Solution:
    """A UR5 that leaves its reference posture and ends at rest, without a solve."""
    robot: Robot = trajopt.robot("ur5")
    way, pace = np.linspace(0.3, -0.4, robot.nv), np.pi / duration
    motion = replace(
        arm_motion(robot, duration),
        q=lambda t: robot.reference + way * (1 - np.cos(pace * t)) / 2,
        v=lambda t: way * pace * np.sin(pace * t) / 2,
        a=lambda t: way * pace**2 * np.cos(pace * t) / 2,
    )
    return sampled(robot, [motion], 8, **meta)


def swinging_quadruped() -> Solution:
    """Solo12 on a virtual base, every joint on a sine, without torques and contacts."""
    robot = trajopt.load("solo12-flip", base="virtual").robot
    still = np.zeros((len(robot.contacts), 6))
    motion = replace(arm_motion(robot), tau=lambda t: np.zeros(robot.nu), f=lambda t: still)
    return sampled(robot, [motion], 4)


def write_own_mjcf(plan: Solution, path: Path) -> Path:
    """The plan's model as MJCF."""
    path.write_text(mjcf_of(plan), encoding="utf-8")
    return path


@dataclass(frozen=True)
class Place:
    """A frame by numeric Pinocchio: pose, velocities of its origin along world axes."""

    pose: pin.SE3
    linear: np.ndarray
    angular: np.ndarray


def place_of(model: pin.Model, frame: str, q: np.ndarray, v: np.ndarray) -> Place:
    """Pose and velocity, by its Jacobian, of a frame, or of a joint where no frame has that name."""
    if not model.existFrame(frame):
        model = pin.Model(model)
        model.addFrame(pin.Frame(frame, model.getJointId(frame), pin.SE3.Identity(), pin.OP_FRAME))
    data = model.createData()
    number = model.getFrameId(frame)
    jacobian = pin.computeFrameJacobian(model, data, q, number, pin.LOCAL_WORLD_ALIGNED)
    pin.framesForwardKinematics(model, data, q)
    rates = jacobian @ v
    return Place(data.oMf[number].copy(), rates[:3], rates[3:])


def moved_on(plan: Solution, passes: int) -> pin.SE3:
    """What carries the first pass of a plan that is periodic without a mirror to a later one."""
    described = plan.description.periodicity
    turn, origin = pin.utils.rotate("z", described.turn), described.origin
    shift = described.moved(float(plan.t[-1] - plan.t[0]))
    once = pin.SE3(turn, origin + shift - turn @ origin)
    found = pin.SE3.Identity()
    for _ in range(passes):
        found = once * found
    return found


def rotation_of(wxyz: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) of a quaternion, the scalar first."""
    return pin.Quaternion(*np.asarray(wxyz, dtype=float)).toRotationMatrix()
