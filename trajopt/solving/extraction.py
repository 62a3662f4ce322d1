"""Convert NLP variables to a Solution: samples of the motion, torques and contact wrenches."""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.collision.near import CollisionScene
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.motion.description import (
    BodyMargins,
    CarriedBody,
    PeriodicImage,
    PlanDescription,
    PlannedContact,
)
from trajopt.motion.solution import Solution
from trajopt.motion.statistics import SolveStatistics
from trajopt.problem.bodies import clearance_of, self_margins, shapes_of
from trajopt.problem.problem import Problem
from trajopt.robot.actuators.joint_force import joint_force
from trajopt.robot.contact import Contact, set_rolling_moments
from trajopt.robot.link_wrench import LinkWrench, wrench_force
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import StanceMode
from trajopt.schedule.schedule import Schedule
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.surface import Surface
from trajopt.transcription.layout import Layout
from trajopt.transcription.schemes import Scheme
from trajopt.transcription.timeline import NodeLayout, StageKind
from trajopt.transcription.transcription import Transcription
from trajopt.versions import VERSIONED, installed_version

# Statistics of a motion that is not the result of a solve.
UNSOLVED: dict[str, Any] = {
    "solver": "",
    "status": "",
    "success": False,
    "converged": False,
    "iterations": 0,
    "objective": None,
    "tolerance": 0.0,
    "wall_time_s": 0.0,
}


def extract(transcription: Transcription, x: np.ndarray, **statistics: Any) -> Solution:
    """Return the solution for scaled variables ``x``.

    Rotations are normalised. They leave the manifold only by the residual of the defects, which is recorded
    as ``rotation_norm_error`` in the statistics.

    Args:
        transcription: Transcription of the problem.
        x: Scaled variables (n_unknowns,).
        **statistics: Known entries of `SolveStatistics`; the others are those of an unsolved motion.
    """
    layout, problem = transcription.layout, transcription.problem
    unknowns = x * transcription.scale
    time_scales = layout.time_scales(unknowns)
    steps = layout.steps * time_scales[layout.phase_of]
    times = layout.times(unknowns)
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("t", "q", "v", "a", "tau", "f")}
    for k in layout.interval_stages:
        phase = int(layout.phase_of[k])
        t = np.array([times[k], *(times[k] + layout.scheme_of(phase).c * steps[k]), times[k + 1]])
        interval = _interval(problem, layout, unknowns, int(k), t, float(time_scales[phase]))
        columns["t"].append(t)
        for name, values in interval.items():
            columns[name].append(values)
    raw = np.concatenate(columns.pop("q"))
    q = np.array([pin.normalize(layout.robot.model, row) for row in raw])
    error = float(np.abs(q - raw).max())
    return Solution(
        description=described(problem),
        statistics=SolveStatistics(
            **{
                **UNSOLVED,
                "transcription": layout.mesh.transcription,
                "mesh": layout.mesh,
                "redundant_contact_rows": dict(transcription.redundant),
                "rotation_norm_error": error if math.isfinite(error) else None,
                "versions": {name: installed_version(name) for name in VERSIONED},
                **statistics,
            }
        ),
        q=q,
        model=problem.robot.limited_model(),
        interval_t=np.column_stack([times[layout.interval_stages], times[layout.interval_stages + 1]]),
        **{name: np.concatenate(parts) for name, parts in columns.items()},
        **_labels(layout),
        **_impacts(problem, layout, unknowns),
    )


def _impacts(problem: Problem, layout: Layout, unknowns: np.ndarray) -> dict[str, np.ndarray]:
    """Return the impulses of each impact, and the index of the sample just after it."""
    stages = layout.transitions_of(StageKind.IMPACT)
    if not stages:
        return {}
    impulses, first = [], []
    for k in stages:
        touching, window = layout.touching[layout.stages[k].phase], unknowns[layout.window(k)]
        levers = problem.levers[layout.stages[k].phase]
        impulses.append(_wrenches(layout, touching, window[layout.local_impulse(k)], levers))
        before = layout.interval_stages[layout.interval_stages < k]
        first.append(int(_widths(layout, before).sum()))
    return {"impulse": np.array(impulses), "impact_index": np.array(first)}


def _labels(layout: Layout) -> dict[str, np.ndarray]:
    """Return ``phase``, ``interval``, ``collocation`` and ``active`` of every sample."""
    widths = _widths(layout, layout.interval_stages)
    inner = np.ones(widths.sum(), dtype=bool)
    ends = np.cumsum(widths)
    inner[[*(ends - widths), *(ends - 1)]] = False
    phase = np.repeat(layout.phase_of[layout.interval_stages], widths)
    return {
        "phase": phase,
        "interval": np.repeat(np.arange(layout.n_intervals), widths),
        "collocation": inner,
        "active": contact_activity(layout.robot, layout.schedule)[phase],
    }


def contact_activity(robot: Robot, schedule: Schedule) -> np.ndarray:
    """Return a mask (n_phases, nc) of the active contacts of a robot in each phase."""
    active = [[contact.name in phase.contacts for contact in robot.contacts] for phase in schedule.phases]
    return np.array(active, dtype=bool).reshape(len(schedule.phases), -1)


def _widths(layout: Layout, stages: np.ndarray) -> np.ndarray:
    """Return the number of samples of each interval: its collocation points and two nodes."""
    return np.array([layout.scheme_of(int(layout.phase_of[k])).s + 2 for k in stages], dtype=int)


def _interval(
    problem: Problem, layout: Layout, unknowns: np.ndarray, k: int, t: np.ndarray, time_scale: float
) -> dict[str, np.ndarray]:
    """Return the motion of the whole robot by the collocation map, and torques by numeric Pinocchio.

    The samples at times ``t``, s, are the start, the collocation points and the end. ``time_scale`` is the
    duration over the nominal duration.
    """
    phase, form, h = int(layout.phase_of[k]), layout.forms[k], float(layout.steps[k] * time_scale)
    method = layout.scheme_of(phase)
    window = unknowns[layout.window(k)]
    nodes = [layout.forms[node].state(unknowns[layout.node(node)])[0] for node in (k, k + 1)]
    outer = method.interpolation(np.array([0.0, 1.0]))
    if layout.order >= 2:
        q, v, a = _motion_at_points(layout, k, window[None], h, time_scale)
        edge = (*form.coordinates.node_to_pinocchio(np.array(nodes)), np.tensordot(outer, a, axes=1))
        if layout.order == 3:
            second = np.array([form.acceleration(unknowns[layout.node(node)]) for node in (k, k + 1)])
            edge = _nodes_in_pinocchio(form, np.array(nodes), second)
    else:
        y, rotations = _inputs(layout, k, window[None])[0][0], nodes[0][form.rotations]
        start = np.zeros(form.coordinates.nv)
        start[form.coordinates.additive_index] = nodes[0][form.additive]
        fractions = np.concatenate([[0.0], method.c, [1.0]])
        weights = np.vstack([np.zeros(method.s), method.A1, method.b1])
        first = method.interpolation(fractions) @ y / time_scale
        second = method.interpolation_rate(fractions) @ y / (time_scale * h)
        xi = start + h * weights @ y / time_scale
        every = form.coordinates.local_to_pinocchio(np.tile(rotations, (len(xi), 1)), xi, first, second)
        q, v, a = (part[1:-1] for part in every)
        edge = (form.coordinates.node_to_pinocchio(np.array(nodes))[0], every[1][[0, -1]], every[2][[0, -1]])
    f = _forces_at_points(problem, layout, k, window[None])
    full = [np.concatenate([e[:1], p, e[1:]]) for p, e in zip((q, v, a), edge, strict=True)]
    mode = layout.modes.get(layout.schedule.phases[phase].name)
    if mode is not None:
        still = np.zeros_like(full[1])
        reaction = mode.ground_reaction(*((full[0], still, still) if layout.order == 1 else full))
        full = mode.lifted(*full)
        _embed(layout, mode, f, reaction[1:-1])
    robot, f = problem.robot_in(layout.schedule.phases[phase].name), _with_ends(outer, f)
    tau = _torques(robot, problem.wrenches, t, full, f)
    if layout.order < 3:
        tau = _with_ends(outer, tau[1:-1])
    return {"q": full[0], "v": full[1], "a": full[2], "f": f, "tau": tau}


def torques_at_start(problem: Problem, layout: Layout, k: int, windows: np.ndarray) -> np.ndarray:
    """Return torques (n, nu) at the start of interval k, from its node and inputs (n, window), unscaled.

    They are of the polynomial through those at the points, or where accelerations are states and nothing
    touches, those of the node.
    """
    phase, form = int(layout.phase_of[k]), layout.forms[k]
    method, name, nodes = layout.scheme_of(phase), layout.schedule.phases[phase].name, windows[:, : form.size]
    state, count = form.state(nodes), len(windows)
    scale = np.array([form.scale_of(node) for node in nodes[:, form.time_scales]])[:, None, None]
    robot, mode = problem.robot_in(name), layout.modes.get(name)
    if form.order == 3 and not layout.n_wrench(phase):
        second = nodes[:, form.accelerations] / scale[:, 0] ** 2
        motion = _nodes_in_pinocchio(form, state, second)
        t, f = np.full(count, layout.node_times[k]), np.zeros((count, len(robot.contacts), 6))
        return _torques(robot, problem.wrenches, t, list(motion), f)
    motion = _motion_at_points(layout, k, windows, layout.steps[k] * scale, scale)
    f = _forces_at_points(problem, layout, k, windows)
    if mode is not None:
        _embed(layout, mode, f, mode.ground_reaction(*motion))
    every = list(motion) if mode is None else mode.lifted(*motion)
    t = np.tile(layout.node_times[k] + method.c * layout.steps[k], count)
    tau = _torques(robot, problem.wrenches, t, every, f).reshape(count, method.s, -1)
    return np.einsum("i,nij->nj", method.interpolation(np.zeros(1))[0], tau)


def _inputs(layout: Layout, k: int, windows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Highest derivatives (n, s, nv) and wrenches (n, s, n_wrench) at the points of windows (n, window)."""
    phase = int(layout.phase_of[k])
    points = range(layout.scheme_of(phase).s)
    y = np.stack([windows[:, layout.local_derivative(phase, i)] for i in points], axis=1)
    return y, np.stack([windows[:, layout.local_wrench(phase, i)] for i in points], axis=1)


def _motion_at_points(
    layout: Layout, k: int, windows: np.ndarray, h: float | np.ndarray, time_scale: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, v, a (n s, ...) at the points of interval k, from windows (n, window); see `_at_points`."""
    form, method = layout.forms[k], layout.scheme_of(int(layout.phase_of[k]))
    nodes, nv = windows[:, : form.size], form.coordinates.nv
    state, start = form.state(nodes), np.zeros((len(windows), nv))
    start[:, form.coordinates.additive_index] = state[:, form.additive]
    begun = start, state[:, -nv:], nodes[:, form.accelerations]
    points = _at_points(form, method, begun, _inputs(layout, k, windows)[0], h, time_scale)
    rotations = np.repeat(state[:, form.rotations], method.s, axis=0)
    return form.coordinates.local_to_pinocchio(rotations, *(part.reshape(-1, nv) for part in points))


def _forces_at_points(problem: Problem, layout: Layout, k: int, windows: np.ndarray) -> np.ndarray:
    """Return the wrenches of all contacts (n s, nc, 6) at the points of interval k."""
    phase, wrenches = int(layout.phase_of[k]), _inputs(layout, k, windows)[1]
    contacts, levers = layout.contacts[phase], problem.levers[phase]
    rows = wrenches.reshape(wrenches.shape[0] * wrenches.shape[1], -1)
    return np.array([_wrenches(layout, contacts, row, levers) for row in rows])


def _embed(layout: Layout, mode: StanceMode, f: np.ndarray, reaction: np.ndarray) -> None:
    """Add to wrenches (n, nc, 6) the force of a mode's own contact, from the ground's total (n, 3)."""
    names = [contact.name for contact in layout.robot.contacts]
    f[:, names.index(mode.embedded.name), :3] = reaction - f[:, :, :3].sum(axis=1)


def _with_ends(outer: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (s, ...) at the points with those of their polynomial at both ends of the interval."""
    ends = np.tensordot(outer, values, axes=1)
    return np.concatenate([ends[:1], values, ends[1:]])


def _at_points(
    form: NodeLayout,
    method: Scheme,
    start: tuple[np.ndarray, np.ndarray, np.ndarray],
    y: np.ndarray,
    h: float | np.ndarray,
    time_scale: float | np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return xi, xi', xi'' (s, nv) at the points, from those at the start and the highest derivative y.

    The start's xi'' and ``y`` are in nominal time, the others in true time. Several windows have a leading
    axis, and ``h`` and ``time_scale`` two more.
    """
    position, rates, second = (part[..., None, :] for part in start)
    c, highest = method.c[:, None], y / time_scale**form.order
    if form.order == 2:
        xi = position + h * (c * rates) + h * h * method.A2 @ highest
        return xi, rates + h * method.A1 @ highest, highest
    second = second / time_scale**2
    xi = position + h * c * rates + (h * c) ** 2 / 2 * second + h**3 * method.points_of(3)[2] @ highest
    return xi, rates + h * c * second + h * h * method.A2 @ highest, second + h * method.A1 @ highest


def _nodes_in_pinocchio(
    form: NodeLayout, states: np.ndarray, second: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, v, a of nodes, from their states (n, n_node) and second derivatives (n, nv)."""
    nv = form.coordinates.nv
    xi = np.zeros((len(states), nv))
    xi[:, form.coordinates.additive_index] = states[:, form.additive]
    return form.coordinates.local_to_pinocchio(states[:, form.rotations], xi, states[:, -nv:], second)


def _torques(
    robot: Robot, wrenches: Sequence[LinkWrench], t: np.ndarray, motion: list[np.ndarray], f: np.ndarray
) -> np.ndarray:
    """Return the actuated rows of RNEA(q, v, a) - J^T f at every point, for the robot with its payload."""
    model, data = robot.model, robot.model.createData()
    frames = [model.getFrameId(contact.frame) for contact in robot.contacts]
    forces = [
        generalized_force(model, data, (q, v, a), frames, wrench)
        for q, v, a, wrench in zip(*motion, f, strict=True)
    ]
    own = joint_force(model, robot.joint_forces, motion[0], motion[1])
    own += wrench_force(model, wrenches, t, motion[0])
    return robot.actuation.inputs(np.array(forces) - own)


def _wrenches(
    layout: Layout, contacts: tuple[Contact, ...], w: np.ndarray, levers: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Return the wrenches of all contacts (nc, 6), zero if inactive; ``levers`` are of rolling contacts."""
    names = [contact.name for contact in layout.robot.contacts]
    f, start = np.zeros((len(names), 6)), 0
    for contact in contacts:
        f[names.index(contact.name), list(contact.rows)] = w[start : start + contact.dimension]
        start += contact.dimension
    set_rolling_moments(f, layout.robot.contacts, levers)
    return f


def described(problem: Problem) -> PlanDescription:
    """Return the description of a problem's solutions."""
    return PlanDescription(
        problem=problem.name,
        parameters=dict(problem.parameters),
        actuation=problem.actuation,
        dynamics=problem.dynamics_kind,
        terrain=problem.terrain,
        phase_names=tuple(phase.name for phase in problem.schedule.phases),
        **described_robot(problem),
    )


def described_robot(problem: Problem) -> dict[str, Any]:
    """Return the robot's entries of a description: contacts and their surfaces, limits, drives, shapes."""
    robot, periodicity = problem.robot, problem.periodicity
    limits = {"effort_limit": robot.torque_limit, "velocity_limit": robot.velocity_limit}
    for term in problem.point_constraints:
        limits |= term.limits(robot)
    limits["effort_limit"] = robot.actuated_row_limit(limits["effort_limit"])
    image = None
    if periodicity is not None:
        index, sign = periodicity.images(robot)
        origin = problem.initial_q[:3].copy()
        image = PeriodicImage(index=index, sign=sign, origin=origin, **asdict(periodicity))
    last = np.array_equal(robot.actuated_rows, np.arange(robot.n_unactuated, robot.nv))
    return {
        "robot": robot.name,
        "actuated_rows": None if last else robot.actuated_rows,
        "thrusters": robot.thrusters,
        "joint_forces": robot.joint_forces,
        "mimics": robot.mimics,
        "joint_limits": robot.joint_limits,
        "contacts": tuple(_contact(contact, problem.terrain.friction) for contact in robot.contacts),
        "surfaces": _surfaces(problem),
        "patches": _patches(problem),
        "goals": tuple(problem.goals),
        "gravity": tuple(robot.model.gravity.linear.tolist()),
        "payloads": _payloads(problem),
        "wrenches": problem.wrenches,
        "periodicity": image,
        "drives": () if robot.drives is None else tuple(robot.drives),
        "visual": robot.visual,
        **{name: _finite(limit) for name, limit in limits.items()},
        **described_bodies(problem),
    }


def described_bodies(problem: Problem) -> dict[str, Any]:
    """Return the entries of a description for link shapes and obstacles."""
    shapes, clearance = shapes_of(problem), clearance_of(problem)
    entries: dict[str, Any] = {"obstacles": tuple(clearance.obstacles), "bodies": None, "margins": None}
    if shapes.shapes or shapes.missing:
        entries["bodies"] = shapes
        if clearance.margin > 0:
            scene = CollisionScene(model=problem.robot.model, shapes=shapes.shapes, self_pairs=shapes.pairs)
            apart = self_margins(problem.robot, scene, clearance.margin)
            entries["margins"] = BodyMargins(obstacles=float(clearance.margin), pairs=apart)
    return entries


def _contact(contact: Contact, friction: float) -> PlannedContact:
    size = (contact.half_length, contact.half_width) if contact.kind == "surface" else None
    return PlannedContact(
        name=contact.name,
        frame=contact.frame,
        kind=contact.kind,
        friction=friction,
        half_size=size,
        radius=contact.radius,
        rolling=contact.rolling,
    )


def _payloads(problem: Problem) -> tuple[CarriedBody, ...]:
    """Return the payloads with the indices of the phases in which they are carried."""
    names = [phase.name for phase in problem.schedule.phases]
    return tuple(
        CarriedBody(
            frame=problem.robot.contact(payload.contact).frame,
            mass=float(payload.mass),
            centre=np.array(payload.centre),
            inertia=np.array(payload.inertia),
            phases=(names.index(name),),
        )
        for name, payload in problem.payloads.items()
    )


def _surfaces(problem: Problem) -> tuple[dict[str, Surface], ...]:
    """Return for each phase the surfaces of contacts other than flat terrain, by frame; empty if none.

    On piecewise terrain these are the planes of the faces; curved ground follows from the terrain itself.
    """
    flat, robot, schedule = isinstance(problem.terrain, FlatGround), problem.robot, problem.schedule
    phases = tuple(
        {
            robot.contact(name).frame: ground.offset(-robot.contact(name).radius)
            for name, ground in problem.surfaces_of(i).items()
            if isinstance(ground, Surface)
            and not (flat and phase.own_surface(name) is None and schedule.patch(i, name) is None)
        }
        for i, phase in enumerate(schedule.phases)
    )
    return phases if any(phases) else ()


def _patches(problem: Problem) -> tuple[dict[str, Patch], ...]:
    """Return for each phase the patches of active contacts, by frame; empty if there are none."""
    robot, schedule = problem.robot, problem.schedule
    phases = tuple(
        {
            robot.contact(name).frame: patch
            for name in phase.contacts
            if (patch := schedule.patch(i, name)) is not None
        }
        for i, phase in enumerate(schedule.phases)
    )
    return phases if any(phases) else ()


def _finite(limit: np.ndarray | None) -> np.ndarray | None:
    """Return a limit as Pinocchio's models store it: the largest float instead of infinity."""
    return None if limit is None else np.minimum(limit, sys.float_info.max)
