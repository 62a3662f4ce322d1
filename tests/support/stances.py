"""Robots on one foot in minimal coordinates."""

from functools import lru_cache

import numpy as np
import pinocchio as pin

from tests.support.problems import FOOT, hopper
from trajopt.robot.data import robot_file
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import StanceMode, stance_mode
from trajopt_library import robots


def _tilted(robot: Robot) -> Robot:
    """The same robot on a root joint that is displaced and turned in the world."""
    model = pin.Model(robot.model)
    model.jointPlacements[1] = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.4, 0.1, -0.2]))
    return Robot.from_model(model, contacts=robot.contacts, reference=robot.reference)


def _go2() -> Robot:
    hips = [f"{leg}_hip_joint" for leg in ("FL", "FR", "RL", "RR")]
    return Robot.from_urdf(
        robot_file("go2_description/urdf/go2.urdf"), base="planar", contacts=["FL_foot", "RR_foot"],
        reference={f"{leg}_{joint}_joint": angle for leg in ("FL", "FR", "RL", "RR")
                   for joint, angle in (("thigh", 0.8), ("calf", -1.6))},
        locked=hips,
    )  # fmt: skip


def _bolt() -> Robot:
    return Robot.from_urdf(
        robot_file("bolt_description/robots/bolt.urdf"), contacts=["FL_FOOT", "FR_FOOT"],
        reference={f"{leg}_{joint}": angle for leg in ("FL", "FR")
                   for joint, angle in (("HFE", 0.5), ("KFE", -1.0))},
    )  # fmt: skip


def _wheel_on_a_leg() -> Robot:
    """A free body with a continuous, an unaligned and a sliding joint to its foot, armature on all."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    parent, generator = base, np.random.default_rng(2)
    kinds = (
        pin.JointModelRUBY(),
        pin.JointModelRevoluteUnaligned(0.36, 0.48, 0.8),
        pin.JointModelPrismaticUnaligned(0.0, 0.6, -0.8),
    )
    for name, kind in zip(("wheel", "skew", "slide"), kinds, strict=True):
        placement = pin.SE3(pin.exp3(generator.uniform(-1, 1, 3)), generator.uniform(-0.3, 0.3, 3))
        parent = model.addJoint(parent, kind, placement, name)
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Identity())
    model.appendBodyToJoint(base, pin.Inertia.Random(), pin.SE3.Identity())
    placement = pin.SE3(pin.exp3(generator.uniform(-1, 1, 3)), generator.uniform(-0.3, 0.3, 3))
    model.addFrame(pin.Frame("tip", parent, 0, placement, pin.FrameType.OP_FRAME))
    model.armature[6:] = [0.1, 0.2, 0.3]
    return Robot.from_model(model, contacts=["tip"])


CASES = {
    "hopper": lambda: (robots.load("hopper"), "foot"),
    "solo12": lambda: (robots.load("solo12"), "HL_FOOT"),
    "bolt": lambda: (_bolt(), "FR_FOOT"),
    "go2-planar": lambda: (_go2(), "RR_foot"),
    "sliding-shank": lambda: (hopper(), FOOT),
    "tilted": lambda: (_tilted(hopper()), FOOT),
    "wheel": lambda: (_wheel_on_a_leg(), "tip"),
}


@lru_cache
def mode_of(name: str) -> StanceMode:
    pin.seed(0)
    robot, contact = CASES[name]()
    return stance_mode(robot, contact)


def random_state(mode: StanceMode, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator, model = np.random.default_rng(seed), mode.robot.model
    q = pin.integrate(model, pin.neutral(model), generator.uniform(-1, 1, model.nv))
    return q, generator.uniform(-2, 2, model.nv), generator.uniform(-5, 5, model.nv)
