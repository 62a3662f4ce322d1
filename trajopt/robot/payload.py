"""A rigid body that a robot carries during some phases: a box in a gripper.

In these phases the body is part of the link that holds it, so its inertia enters the dynamics exactly. A
solution has one model, the robot's own, and describes the bodies and their phases. On that model the body
exerts a wrench at the holding contact: by Newton and Euler, in the axes of the contact's frame,

    w = -(Y (a - g) + v x* Y v)          Y = spatial inertia of the body at the frame's origin

(Featherstone, "Rigid Body Dynamics Algorithms", 2008, eq. 2.72): RNEA(q, v, a) - J^T w of that model gives
the torques of the robot with its load.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
import pinocchio as pin

from trajopt.arguments import Array3, Array33, ArrayShape, NonNegative, checked
from trajopt.errors import InputError, finite_array, require_not_negative
from trajopt.robot.contact import require_frame
from trajopt.robot.robot import Robot


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Payload:
    """A rigid body held at a contact of the robot.

    Args:
        contact: name of the contact that holds it; its frame gives the axes.
        mass: mass, kg.
        centre: centre of mass (3,), m, in the contact's frame; default its origin.
        inertia: inertia about the centre of mass (3, 3), kg m^2, in the frame's axes; default a point mass.
        points: points (n, 3), m, in the contact's frame, whose convex hull is the body that keeps clear of
            obstacles, ground and links; default the solid box of its mass and inertia, or the point mass.
        radius: how far the body extends beyond that hull, m.

    Raises:
        InputError: for a mass, an inertia or a shape that no rigid body has.
    """

    contact: str
    mass: NonNegative
    centre: Array3 = field(default_factory=lambda: np.zeros(3))
    inertia: Array33 = field(default_factory=lambda: np.zeros((3, 3)))
    points: Annotated[np.ndarray, ArrayShape((None, 3))] | None = None
    radius: NonNegative = 0.0

    def __post_init__(self) -> None:
        require_rigid(self.inertia)
        if (self.radius and self.points is None) or (self.points is not None and not len(self.points)):
            raise InputError("a payload has no points for its shape", "allowed: points (n, 3), n >= 1")

    @property
    def spatial(self) -> pin.Inertia:
        """Spatial inertia in the axes of the contact's frame, about its origin."""
        return pin.Inertia(float(self.mass), self.centre, self.inertia)


def require_rigid(inertia: np.ndarray) -> None:
    """Raise `InputError` for the inertia (3, 3) of a payload that no rigid body has."""
    moments = np.linalg.eigvalsh(inertia)
    if not np.allclose(inertia, inertia.T) or moments[0] < 0:
        raise InputError(
            "inertia of a payload is not that of a rigid body", "allowed: symmetric, eigenvalues >= 0"
        )
    if moments[2] > moments[0] + moments[1] + 1e-12 * moments[2]:
        raise InputError(
            f"principal moments of a payload are {moments}", "allowed: none above the sum of the others"
        )


def loaded_model(model: pin.Model, frame: str, body: pin.Inertia) -> pin.Model:
    """A copy of the model with a body, given in the axes of ``frame``, added to the link of that frame."""
    carrying = pin.Model(model)
    held = carrying.frames[carrying.getFrameId(frame)]
    carrying.appendBodyToJoint(held.parentJoint, body, held.placement)
    return carrying


def loaded(robot: Robot, payload: Payload) -> Robot:
    """The robot with the payload as part of the link that holds it."""
    frame = robot.contact(payload.contact).frame
    return replace(robot, model=loaded_model(robot.model, frame, payload.spatial))


def with_mass(robot: Robot, mass: float, frame: str, place: Sequence[float]) -> Robot:
    """The robot with a point mass, kg, at a place (3,), m, in the axes of a frame. Raises `InputError`."""
    require_not_negative("mass of a payload", mass, "kg")
    require_frame(robot.model, frame, "a payload")
    body = pin.Inertia(mass, finite_array("place of a payload", place, unit="m"), np.zeros((3, 3)))
    return replace(robot, model=loaded_model(robot.model, frame, body))


def payload_wrench(
    model: pin.Model,
    data: pin.Data,
    frame: str,
    body: pin.Inertia,
    state: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """Wrench (6,) of a carried body on the robot: world axes, at the frame's origin, N and N m."""
    index = model.getFrameId(frame)
    pin.forwardKinematics(model, data, *state)
    rotation = pin.updateFramePlacement(model, data, index).rotation
    velocity = pin.getFrameVelocity(model, data, index, pin.LOCAL)
    acceleration = pin.getFrameAcceleration(model, data, index, pin.LOCAL)
    acceleration.linear -= rotation.T @ model.gravity.linear
    wrench = body * acceleration + velocity.cross(body * velocity)
    return -np.concatenate([rotation @ wrench.linear, rotation @ wrench.angular])
