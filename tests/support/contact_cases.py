"""Models in contact whose dynamics other code, or a formula, knows."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from tests.support.models import robot
from trajopt.certify.contact.contact_set import ContactSet

FEET = tuple(f"{leg}_FOOT" for leg in ("FL", "FR", "HL", "HR"))

# name: robot, contacts (frame, dimension); their rows are independent at the states below
INDEPENDENT = {
    "solo12 on two feet": ("solo12", [("FL_FOOT", 3), ("HR_FOOT", 3)]),
    "solo12 on four feet": ("solo12", [(foot, 3) for foot in FEET]),
    "talos on its soles": ("talos", [("left_sole_link", 6), ("right_sole_link", 6)]),
    "talos, a sole and a hand": ("talos", [("left_sole_link", 6), ("arm_right_7_link", 3)]),
    "ur5, point at a wall": ("ur5", [("tool0", 3)]),
    "ur5, flange at a wall": ("ur5", [("tool0", 6)]),
    "planar go2 on two feet": ("go2_planar", [("FL_foot", 3), ("RR_foot", 3)]),
}


@dataclass(frozen=True)
class Case:
    """A model, its contacts and a state of generic numbers; ``tau`` acts on every row."""

    model: pin.Model
    contacts: ContactSet
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray


@lru_cache
def independent(name: str) -> Case:
    robot_name, contacts = INDEPENDENT[name]
    model, _ = robot(robot_name)
    generator = np.random.default_rng(list(INDEPENDENT).index(name))
    q = pin.integrate(model, pin.neutral(model), generator.uniform(-1, 1, model.nv))
    v, tau = generator.standard_normal(model.nv), 10 * generator.standard_normal(model.nv)
    return Case(model, ContactSet.of(model, contacts), q, v, tau)


def body(
    points: dict[str, tuple[float, float, float]], mass: float = 2.0, inertia: float | np.ndarray = 0.3
) -> pin.Model:
    """A free rigid body with its centre of mass at the origin and frames at ``points`` of it."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    tensor = np.diag(np.broadcast_to(inertia, 3))
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), tensor), pin.SE3.Identity())
    for name, place in points.items():
        placement = pin.SE3(np.eye(3), np.array(place, dtype=float))
        model.addFrame(pin.Frame(name, joint, 0, placement, pin.OP_FRAME))
    return model


def close(actual: np.ndarray, expected: np.ndarray, relative: float) -> None:
    """Assert that arrays agree to ``relative`` of the largest entry."""
    scale = max(float(np.abs(expected).max(initial=0.0)), 1.0)
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=relative * scale)


def vanishes(actual: np.ndarray, zero: float) -> None:
    """Assert that no entry is larger than ``zero``."""
    assert np.abs(actual).max(initial=0.0) <= zero


def pinocchio_constraints(case: Case) -> tuple[pin.Data, list, list]:
    """Pinocchio's own contact models for a case, in world-aligned axes."""
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for frame_id, size in zip(case.contacts.frames, case.contacts.dimensions, strict=True):
        frame = case.model.frames[frame_id]
        kind = pin.ContactType.CONTACT_3D if size == 3 else pin.ContactType.CONTACT_6D
        axes = pin.LOCAL_WORLD_ALIGNED
        models.append(pin.RigidConstraintModel(kind, case.model, frame.parentJoint, frame.placement, axes))
    for model in models:
        datas.append(model.createData())
    data = case.model.createData()
    pin.initConstraintDynamics(case.model, data, models, datas)
    return data, models, datas
