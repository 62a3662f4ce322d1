"""Bodies that a plan carries: their wrenches by Newton-Euler, and the model with them attached."""

import warnings
from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from trajopt.motion.solution import Solution
from trajopt.robot.payload import loaded_model, payload_wrench


def warn_of_payloads(plans: Iterable[Solution], format: str) -> None:
    """Warn of carried bodies that a format leaves out, though torques and forces include their weight."""
    for plan in plans:
        masses = ", ".join(f"{body.mass:g} kg on {body.frame}" for body in plan.description.payloads)
        if masses:
            text = f"{format} leaves out the payload: {masses}; torques and forces are those with it"
            warnings.warn(text, UserWarning, stacklevel=2)


def carrying_model(plan: Solution, phase: int) -> pin.Model:
    """Return the plan's model with everything that the robot carries in a phase."""
    model = plan.model
    for body in plan.description.carried_in(phase):
        model = loaded_model(model, body.frame, body.spatial)
    return model


def payload_wrenches(plan: Solution) -> np.ndarray:
    """Return the wrenches (K, nc, 6) of carried bodies on the robot, recomputed from the motion."""
    model, data = plan.model, plan.model.createData()
    wrenches = np.zeros_like(plan.f)
    for row in range(plan.n_samples):
        for body in plan.description.carried_in(int(plan.phase[row])):
            index = plan.contact_frames.index(body.frame)
            state = (plan.q[row], plan.v[row], plan.a[row])
            wrenches[row, index] += payload_wrench(model, data, body.frame, body.spatial, state)
    return wrenches
