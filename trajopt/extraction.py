"""From solved unknowns to a Solution: samples of motion, torques and contact wrenches."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.layout import Layout
from trajopt.model_quantities import generalized_force
from trajopt.robot_drives import actuated_row_limit
from trajopt.solution import Solution
from trajopt.transcription import Transcription
from trajopt.versions import installed_version

VERSIONED = ("trajopt", "casadi", "pin", "numpy")


@dataclass(frozen=True)
class _Points:
    """Values at the s points of one interval; ``f`` (s, nc, 6)."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    f: np.ndarray


def extract(transcription: Transcription, x: np.ndarray, meta: dict[str, Any]) -> Solution:
    """Solution of scaled unknowns ``x``; ``meta`` adds what the solver knows to what the problem says.

    Rotations are normalised: they leave the manifold only by what the solver's tolerance leaves in the
    defects, which ``rotation_norm_error`` in meta keeps on record.
    """
    layout = transcription.layout
    unknowns = x * transcription.scale
    nodes_q, nodes_v = layout.coordinates.node_to_pinocchio(
        np.array([unknowns[layout.node(k)] for k in range(layout.n_intervals + 1)])
    )
    ends = layout.scheme.interpolation(np.array([0.0, 1.0]))
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("t", "q", "v", "a", "tau", "f")}
    for k in range(layout.n_intervals):
        points = _points(layout, unknowns, k)
        times = layout.node_times[k] + layout.scheme.c * layout.steps[k]
        columns["t"].append(np.concatenate([[layout.node_times[k]], times, [layout.node_times[k + 1]]]))
        columns["q"].append(np.vstack([nodes_q[k], points.q, nodes_q[k + 1]]))
        columns["v"].append(np.vstack([nodes_v[k], points.v, nodes_v[k + 1]]))
        for name in ("a", "tau", "f"):
            inner = getattr(points, name)
            outer = np.tensordot(ends, inner, axes=1)
            columns[name].append(np.concatenate([outer[:1], inner, outer[1:]]))
    raw = np.concatenate(columns.pop("q"))
    q = np.array([pin.normalize(layout.robot.model, row) for row in raw])
    error = float(np.abs(q - raw).max())
    return Solution(
        meta={
            **_problem_meta(transcription),
            "rotation_norm_error": error if math.isfinite(error) else None,
            **meta,
        },
        q=q,
        model_text=transcription.problem.robot.limited_model().saveToString(),
        interval_t=np.column_stack([layout.node_times[:-1], layout.node_times[1:]]),
        **{name: np.concatenate(parts) for name, parts in columns.items()},
        **_labels(layout),
    )


def _labels(layout: Layout) -> dict[str, np.ndarray]:
    """Phase, interval, collocation and active of every sample."""
    width = layout.scheme.s + 2
    inner = np.ones(width, dtype=bool)
    inner[[0, -1]] = False
    every = [contact.name for contact in layout.robot.contacts]
    phases = layout.schedule.phases
    active = np.array([[name in phase.contacts for name in every] for phase in phases], dtype=bool)
    phase = np.repeat(layout.phase_of, width)
    return {
        "phase": phase,
        "interval": np.repeat(np.arange(layout.n_intervals), width),
        "collocation": np.tile(inner, layout.n_intervals),
        "active": active.reshape(len(phases), len(every))[phase],
    }


def _points(layout: Layout, unknowns: np.ndarray, k: int) -> _Points:
    """Motion from the collocation map, torques from numeric Pinocchio."""
    phase, method, coordinates = int(layout.phase_of[k]), layout.scheme, layout.coordinates
    h = layout.steps[k]
    window = unknowns[layout.node_offset[k] : layout.node_offset[k] + layout.window_size(phase)]
    y = np.array([window[layout.local_acceleration(phase, i)] for i in range(method.s)])
    start, rates = np.zeros(coordinates.nv), window[layout.local_rates]
    start[coordinates.additive_index] = window[layout.local_additive]
    xi = start + h * np.outer(method.c, rates) + h * h * method.A2 @ y
    dxi = rates + h * method.A1 @ y
    rotations = np.tile(window[layout.local_rotations], (method.s, 1))
    q, v, a = coordinates.local_to_pinocchio(rotations, xi, dxi, y)
    f = np.array([_wrenches(layout, phase, window[layout.local_wrench(phase, i)]) for i in range(method.s)])
    model, data = layout.robot.model, layout.robot.model.createData()
    frames = [model.getFrameId(contact.frame) for contact in layout.robot.contacts]
    forces = [generalized_force(model, data, (q[i], v[i], a[i]), frames, f[i]) for i in range(method.s)]
    tau = np.array(forces)[:, layout.robot.n_unactuated :]
    return _Points(q, v, a, tau, f)


def _wrenches(layout: Layout, phase: int, w: np.ndarray) -> np.ndarray:
    """Wrench of every contact of the robot (nc, 6), zero where inactive."""
    names = [contact.name for contact in layout.robot.contacts]
    f, start = np.zeros((len(names), 6)), 0
    for contact in layout.contacts[phase]:
        f[names.index(contact.name), : contact.dimension] = w[start : start + contact.dimension]
        start += contact.dimension
    return f


def _problem_meta(transcription: Transcription) -> dict[str, Any]:
    problem, robot = transcription.problem, transcription.problem.robot
    limits = {"effort_limit": robot.effort_limit, "velocity_limit": robot.velocity_limit}
    for term in problem.point_constraints:
        limits |= term.limits(robot)
    limits["effort_limit"] = actuated_row_limit(robot, limits["effort_limit"])
    meta: dict[str, Any] = {
        "problem": problem.name,
        "parameters": dict(problem.parameters),
        "robot": robot.name,
        "contact_frames": [contact.frame for contact in robot.contacts],
        "contact_kinds": [contact.kind for contact in robot.contacts],
        "contact_sizes": [
            [c.half_length, c.half_width] if c.kind == "surface" else None for c in robot.contacts
        ],
        "friction": [problem.terrain.friction for _ in robot.contacts],
        "terrain": problem.terrain.describe(),
        "transcription": transcription.layout.scheme.name,
        "intervals": list(transcription.layout.intervals),
        "phase_names": [phase.name for phase in problem.schedule.phases],
        "gravity": robot.model.gravity.linear.tolist(),
        "versions": {name: installed_version(name) for name in VERSIONED},
        **{name: _as_numbers(limit) for name, limit in limits.items()},
    }
    if robot.drives is not None:
        meta["drives"] = [None if drive is None else drive.to_meta() for drive in robot.drives]
    if robot.visual is not None:
        meta["visual"] = robot.visual.to_meta()
    return meta


def _as_numbers(limit: np.ndarray | None) -> list[float] | None:
    """A limit for JSON, which has no infinity: unlimited is the largest number, as in Pinocchio's models."""
    return None if limit is None else np.minimum(limit, sys.float_info.max).tolist()
