"""Figures of the check for impacts: impact law, momentum, energy, and state jumps without an impact."""

import math

import numpy as np
import pinocchio as pin

from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.certify.contact.friction import cone_margins
from trajopt.certify.contact.impact import momentum_of_links, total_wrench
from trajopt.certify.reintegration import active_contacts
from trajopt.motion.quantities import MotionQuantities

_Figures = dict[str, float | None]


def impact_figures(motion: MotionQuantities) -> _Figures:
    """Return the worst figures over all impacts of a motion, None without impacts, and the state jump.

    The contacts of an impact are those that are active just after it. Speeds are over sqrt(g 1 m), momenta
    over the mass times that, angular momenta over 1 m more, energies over the weight times 1 m.
    """
    index = motion.solution.impact_index
    rows = [] if index is None else [int(row) for row in index]
    impacts = [_impact(motion, number, row) for number, row in enumerate(rows)]
    worst: _Figures = {}
    for name in (
        "impact_residual",
        "impact_velocity",
        "impact_friction_margin",
        "impact_momentum_error",
        "impact_energy_gain",
    ):
        values = [figures[name] for figures in impacts if figures[name] is not None]
        choose = min if name == "impact_friction_margin" else max
        worst[name] = choose(values) if values else None  # type: ignore[type-var]
    return {**worst, "state_jump": _state_jump(motion, rows)}


def _impact(motion: MotionQuantities, number: int, row: int) -> _Figures:
    plan, surfaces, phase = motion.solution, motion.surfaces, int(motion.solution.phase[row])
    assert plan.impulse is not None
    q, before, after = plan.q[row], plan.v[row - 1], plan.v[row]
    model, active = motion.models[phase], plan.active[row]
    contacts = active_contacts(motion, row)
    impulses = plan.impulse[number][active]
    data = model.createData()
    mass = pin.crba(model, data, q)
    kinematics = contact_kinematics(model, data, q, after, contacts)
    stacked = contacts.stacked(impulses)
    speed = math.sqrt(motion.gravity)
    unit = motion.masses[phase] * speed
    pressed = ~surfaces.bilateral[row, active]
    margins = cone_margins(impulses, surfaces.normal[row, active], surfaces.friction[row, active])[pressed]
    energies = [v @ mass @ v / 2 for v in (before, after)]
    return {
        "impact_residual": float(
            np.abs(mass @ (after - before) - kinematics.jacobian.T @ stacked).max() / unit
        ),
        "impact_velocity": float(np.abs(kinematics.velocity).max() / speed),
        "impact_friction_margin": float(margins.min() / unit) if margins.size else None,
        "impact_momentum_error": _momentum_error(motion, row, contacts, impulses, unit),
        "impact_energy_gain": float((energies[1] - energies[0]) / (motion.masses[phase] * motion.gravity)),
    }


def _momentum_error(
    motion: MotionQuantities, row: int, contacts: ContactSet, impulses: np.ndarray, unit: float
) -> float | None:
    """Return the change of linear and angular momentum about the centre of mass minus the impulses.

    None for a fixed base, whose root transmits an impulse. For a planar base only the free components count.
    """
    plan, base = motion.solution, motion.base
    q, model = plan.q[row], motion.models[int(plan.phase[row])]
    if base == "fixed":
        return None
    jump = momentum_of_links(model, q, plan.v[row]) - momentum_of_links(model, q, plan.v[row - 1])
    given = total_wrench(model, q, contacts, impulses, jump.point)
    linear, angular = jump.linear - given.linear, jump.angular - given.angular
    if base == "planar":
        axes = model.jointPlacements[1].rotation
        linear, angular = linear @ axes[:, :2], angular @ axes[:, 2:]
    return float(max(np.abs(linear).max(), np.abs(angular).max()) / unit)


def _state_jump(motion: MotionQuantities, impacts: list[int]) -> float | None:
    """Return the largest jump of q (m, rad) between intervals, and of v over sqrt(g 1 m) without an impact.

    With velocity sources v may jump.
    """
    plan = motion.solution
    starts = [rows.start for rows in plan.intervals[1:]]
    if not starts:
        return None
    speed, worst = math.sqrt(motion.gravity), 0.0
    for row in starts:
        worst = max(worst, float(np.abs(pin.difference(plan.model, plan.q[row - 1], plan.q[row])).max()))
        if row not in impacts and not motion.moved_by_rates:
            worst = max(worst, float(np.abs(plan.v[row] - plan.v[row - 1]).max() / speed))
    return worst
