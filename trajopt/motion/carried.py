"""Bodies that a plan carries: their wrenches by Newton and Euler, and the model that carries them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.robot.payload import loaded_model, payload_wrench
from trajopt.solution.solution import Solution


def payloads_in(plan: Solution, phase: int) -> list[dict[str, Any]]:
    """Descriptions of what is carried in a phase, from the optional key ``payloads`` of meta."""
    return [entry for entry in plan.meta.get("payloads") or [] if phase in entry["phases"]]


def payload_inertia(entry: dict[str, Any]) -> pin.Inertia:
    """The spatial inertia that a description gives, in the axes of its frame."""
    return pin.Inertia(entry["mass"], np.array(entry["centre"]), np.array(entry["inertia"]))


def carrying_model(plan: Solution, phase: int) -> pin.Model:
    """The plan's model with everything that is carried in a phase."""
    model = plan.model
    for entry in payloads_in(plan, phase):
        model = loaded_model(model, entry["frame"], payload_inertia(entry))
    return model


def payload_wrenches(plan: Solution) -> np.ndarray:
    """Wrenches (K, nc, 6) of carried bodies on the robot, recomputed from the motion."""
    model, data = plan.model, plan.model.createData()
    wrenches = np.zeros_like(plan.f)
    for row in range(plan.n_samples):
        for entry in payloads_in(plan, int(plan.phase[row])):
            index = plan.contact_frames.index(entry["frame"])
            state = (plan.q[row], plan.v[row], plan.a[row])
            wrenches[row, index] += payload_wrench(model, data, entry["frame"], payload_inertia(entry), state)
    return wrenches
