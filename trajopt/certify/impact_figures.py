"""Figures of a check about impacts: their law, momentum, energy, and jumps where there is no impact."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.certify.contact.friction import cone_margins
from trajopt.certify.contact.impact import momentum_of_links, total_wrench
from trajopt.certify.reintegration import active_contacts
from trajopt.dynamics.base_joint import base_of
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.motion.carried import carrying_model
from trajopt.motion.touched import TouchedSurfaces
from trajopt.solution.solution import Solution

_Figures = dict[str, float | None]


def impact_figures(plan: Solution, surfaces: TouchedSurfaces) -> _Figures:
    """Worst figures over all impacts of ``plan``, None without any, and of jumps elsewhere.

    The contacts of an impact are those that are active just after it. Speeds are over sqrt(g 1 m),
    momenta over the mass times that, angular ones over one metre more, energies over the weight times one
    metre.
    """
    rows = [] if plan.impact_index is None else [int(row) for row in plan.impact_index]
    found = [_impact(plan, surfaces, number, row) for number, row in enumerate(rows)]
    worst: _Figures = {}
    for name in (
        "impact_residual",
        "impact_velocity",
        "impact_friction_margin",
        "impact_momentum_error",
        "impact_energy_gain",
    ):
        values = [figures[name] for figures in found if figures[name] is not None]
        choose = min if name == "impact_friction_margin" else max
        worst[name] = choose(values) if values else None  # type: ignore[type-var]
    return {**worst, "state_jump": _state_jump(plan, rows)}


def _impact(plan: Solution, surfaces: TouchedSurfaces, number: int, row: int) -> _Figures:
    assert plan.impulse is not None
    q, before, after = plan.q[row], plan.v[row - 1], plan.v[row]
    model = carrying_model(plan, int(plan.phase[row]))
    active = plan.active[row]
    contacts = active_contacts(plan, model, row)
    impulses = plan.impulse[number][active]
    data = model.createData()
    mass = pin.crba(model, data, q)
    kinematics = contact_kinematics(model, data, q, after, contacts)
    stacked = contacts.stacked(impulses)
    speed = math.sqrt(gravity_of(model))
    unit = mass_of(model) * speed
    pressed = ~surfaces.bilateral[row, active]
    margins = cone_margins(impulses, surfaces.normal[row, active], surfaces.friction[row, active])[pressed]
    energies = [v @ mass @ v / 2 for v in (before, after)]
    return {
        "impact_residual": float(
            np.abs(mass @ (after - before) - kinematics.jacobian.T @ stacked).max() / unit
        ),
        "impact_velocity": float(np.abs(kinematics.velocity).max() / speed),
        "impact_friction_margin": float(margins.min() / unit) if margins.size else None,
        "impact_momentum_error": _momentum_error(plan, model, row, contacts, impulses, unit),
        "impact_energy_gain": float((energies[1] - energies[0]) / (mass_of(model) * gravity_of(model))),
    }


def _momentum_error(
    plan: Solution, model: pin.Model, row: int, contacts: ContactSet, impulses: np.ndarray, unit: float
) -> float | None:
    """Change of linear and angular momentum about the centre of mass against the impulses'.

    None for a fixed base, whose root transmits an impulse; for a planar base only its free components.
    """
    q = plan.q[row]
    base = base_of(plan.model)
    if base == "fixed":
        return None
    jump = momentum_of_links(model, q, plan.v[row]) - momentum_of_links(model, q, plan.v[row - 1])
    given = total_wrench(model, q, contacts, impulses, jump.point)
    linear, angular = jump.linear - given.linear, jump.angular - given.angular
    if base == "planar":
        axes = model.jointPlacements[1].rotation
        linear, angular = linear @ axes[:, :2], angular @ axes[:, 2:]
    return float(max(np.abs(linear).max(), np.abs(angular).max()) / unit)


def _state_jump(plan: Solution, impacts: list[int]) -> float | None:
    """Largest jump of q (m, rad) and, over sqrt(g 1 m), of v where intervals meet without an impact.

    The velocity of a velocity source may jump.
    """
    starts = [rows.start for rows in plan.intervals[1:]]
    if not starts:
        return None
    speed = math.sqrt(gravity_of(plan.model))
    worst = 0.0
    for row in starts:
        worst = max(worst, float(np.abs(pin.difference(plan.model, plan.q[row - 1], plan.q[row])).max()))
        if row not in impacts and plan.description.actuation != "velocity":
            worst = max(worst, float(np.abs(plan.v[row] - plan.v[row - 1]).max() / speed))
    return worst
