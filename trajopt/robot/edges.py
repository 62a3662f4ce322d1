"""Heel and toe of a sole: its edges across x, each held by the two corners at its ends.

A foot that stands on an edge turns freely about it. Forces at the two corners of the edge have no moment
about it, and produce every other wrench of the edge. The rows that hold both corners have rank five, since
the distance between them is fixed. Forces in friction pyramids at all four corners are equivalent to those of
a flat sole (`trajopt.terms.friction.SoleCone`). A sole that rolls is therefore four point contacts, each held
from its touchdown to its lift-off. When the foot comes down flat, only its rotation about the heel is left to
be stopped (`trajopt.transcription.redundancy` leaves out the dependent rows).
"""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_JOINT
from trajopt.errors import InputError
from trajopt.robot.contact import Contact
from trajopt.robot.robot import Robot

Edge = Literal["heel", "toe"]
EDGES: tuple[Edge, ...] = get_args(Edge)
# Least |cosine| between a sole's x axis and the base's: below it, the edges across x are the sole's sides.
LEAST_COSINE = 0.7


@checked
def edge_contacts(sole: str, edge: Edge) -> tuple[str, str]:
    """Names of the contacts at the left and the right end of an edge of a sole, see `with_edges`."""
    return f"{sole}_{edge}_left", f"{sole}_{edge}_right"


@checked
def with_edges(robot: Robot) -> Robot:
    """Return the robot with each sole replaced by point contacts at its corners, to stand on heels and toes.

    Contacts and the frames added for them are named by `edge_contacts` and have the axes of the sole. The toe
    is the front edge in the reference posture.

    Raises:
        InputError: for a robot without soles, or with soles that do not point forward or back.
    """
    if not any(contact.kind == "surface" for contact in robot.contacts):
        raise InputError(f"robot '{robot.name}' has no sole", "allowed: contacts of kind 'surface'")
    model, contacts = pin.Model(robot.model), []
    for contact in robot.contacts:
        contacts += _corners(robot, model, contact) if contact.kind == "surface" else [contact]
    return replace(robot, model=model, contacts=tuple(contacts))


def _corners(robot: Robot, model: pin.Model, sole: Contact) -> list[Contact]:
    """Contacts at the corners of a sole, whose frames are added to ``model``."""
    forward = _forward(robot, sole)
    if abs(forward) < LEAST_COSINE:
        raise InputError(
            f"sole '{sole.name}' of robot '{robot.name}' lies across the base's x axis",
            "allowed: soles whose x axis points forward or back",
        )
    frame = model.frames[model.getFrameId(sole.frame)]
    ahead, corners = float(np.sign(forward)), []
    for edge, x in zip(EDGES, (-ahead, ahead), strict=True):
        for name, y in zip(edge_contacts(sole.name, edge), (ahead, -ahead), strict=True):
            place = pin.SE3(np.eye(3), np.array([x * sole.half_length, y * sole.half_width, 0.0]))
            corner = pin.Frame(
                name, frame.parentJoint, frame.parentFrame, frame.placement * place, pin.FrameType.OP_FRAME
            )
            model.addFrame(corner)
            corners.append(Contact(frame=name))
    return corners


def _forward(robot: Robot, sole: Contact) -> float:
    """Cosine between a sole's x axis and the base's in the reference posture."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    base = data.oMi[BASE_JOINT[robot.base]].rotation
    return float(base[:, 0] @ data.oMf[robot.model.getFrameId(sole.frame)].rotation[:, 0])
