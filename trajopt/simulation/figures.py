"""Figures of a simulation: tracking, contacts and falls, from its record and the plan."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin

from trajopt.control.reference import ContactTimeline, ReferenceTrajectory
from trajopt.motion.samples import state_distance
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.scene import Scene, touching_places
from trajopt.simulation.site import base_poses, upwards

# A contact is loaded above this fraction of the weight: far above rounding, far below a leg's share.
LOADED = 0.02
# Travel of a loaded contact within a stance, in reaches, that counts as a slip.
SLIP = 0.01
# MuJoCo pulses the force on a fast-sliding contact: gaps shorter than this fraction of the natural time are
# ignored.
PULSES = 0.1
# A base has fallen if it drops below the plan by this fraction of its mean height over the feet, or turns
# from the planned attitude by more than this, rad.
LARGEST_DROP = 0.5
LARGEST_TILT = np.pi / 3


@dataclass(frozen=True, kw_only=True)
class Fall:
    """First time of a fall, s of the plan, and its reason."""

    time: float
    why: str


@dataclass(frozen=True, kw_only=True)
class SimulatedStance:
    """One planned stance of a contact in the simulation.

    Args:
        touchdown: simulated minus planned, s; None from the start, or without load by mid-stance.
        missed: whether it never carries load, unless it is held or meant to slide.
        travel: m along the surface while loaded, for a sole that of its corners; None if held or sliding.
    """

    contact: int
    start: float
    touchdown: float | None
    missed: bool
    travel: float | None


@dataclass(frozen=True, kw_only=True)
class TrackingErrors:
    """Errors at n + 1 times: base, m; turn, rad; the worst joint's, rad or m; all joints' (n + 1, .)."""

    base: np.ndarray
    turn: np.ndarray
    joint: np.ndarray
    joints: np.ndarray


def tracking_errors(scene: Scene, reference: ReferenceTrajectory, q: np.ndarray) -> TrackingErrors:
    """Errors of simulated q (n + 1, nq) at the starts of all periods and at the end of the last one."""
    wanted = np.vstack([reference.q, reference.end])[: len(q)]
    model, rows = scene.robot.model, scene.robot.actuated_rows
    distance = np.array([state_distance(model, a, b) for a, b in zip(wanted, q, strict=True)])
    joints = np.array([pin.difference(model, a, b)[rows] for a, b in zip(wanted, q, strict=True)])
    return TrackingErrors(base=distance[:, 0], turn=distance[:, 1], joint=distance[:, 2], joints=joints)


def loaded_contacts(record: SimulationRecord, scene: Scene) -> np.ndarray:
    """Whether each contact carries load (n, nc)."""
    force = np.linalg.norm(record.force[:, :, :3], axis=2)
    return np.asarray(force > LOADED * scene.units.weight)


def simulated_stances(
    reference: ReferenceTrajectory, record: SimulationRecord, scene: Scene
) -> tuple[SimulatedStance, ...]:
    """All planned stances, contact by contact."""
    n = min(len(record.feet), reference.planned)
    loaded, surfaces, stances = loaded_contacts(record, scene)[:n], scene.site.surfaces, []
    gap = round(PULSES * scene.units.time / reference.period)
    for contact in range(loaded.shape[1]):
        runs = _runs(reference.active[:n, contact])
        for number, (first, end) in enumerate(runs):
            before = runs[number - 1][1] if number else 0
            window = (before + first) // 2 if first else 0
            # Up to mid-stance: a later load is not a touchdown.
            touch = np.flatnonzero(loaded[window : (first + end) // 2 + 1, contact])
            normal = surfaces.normal[reference.source[first], contact]
            phases = np.unique(reference.source[first:end])
            free = bool((surfaces.bilateral | surfaces.slides)[phases, contact].any())
            late = (window + int(touch[0]) - first) * reference.period if len(touch) else None
            stances.append(
                SimulatedStance(
                    contact=contact,
                    start=float(reference.t[first]),
                    touchdown=late if first else None,
                    missed=not loaded[first:end, contact].any() and not free,
                    travel=None
                    if free
                    else farthest_travel(
                        _slipped(scene, contact, record, slice(first, end), normal),
                        _without_gaps(loaded[first:end, contact], gap),
                        normal,
                    ),
                )
            )
    return tuple(stances)


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """First index, and one past the last, of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _without_gaps(loaded: np.ndarray, gap: int) -> np.ndarray:
    """Fill gaps of at most ``gap`` between runs of true flags (n,)."""
    closed = loaded.copy()
    for first, end in _runs(~loaded):
        if first and end < len(loaded) and end - first <= gap:
            closed[first:end] = True
    return closed


def _slipped(
    scene: Scene, contact: int, record: SimulationRecord, rows: slice, normal: np.ndarray
) -> np.ndarray:
    """Positions (n, c, 3), m, of a contact's points; for a rolling ball its centre, less the way rolled."""
    feet, turns = record.feet[rows, contact, None], record.turns[rows, contact]
    places = feet + touching_places(scene.robot.description.contacts[contact]) @ turns.mT
    radius = float(scene.place.radii[contact])
    if not scene.place.rolling[contact] or len(turns) < 2:
        return np.asarray(places)
    steps = np.array([pin.log3(after @ before.T) for before, after in pairwise(turns)])
    rolled = np.cumsum(np.vstack([np.zeros(3), np.cross(steps, radius * normal)]), axis=0)
    return np.asarray(places - rolled[:, None])


def farthest_travel(places: np.ndarray, loaded: np.ndarray, normal: np.ndarray) -> float:
    """Largest displacement of any of ``places`` (n, c, 3) along a contact's plane without being lifted."""
    farthest = 0.0
    for first, end in _runs(loaded):
        moved = places[first:end] - places[first]
        along = moved - (moved @ normal)[..., None] * normal
        farthest = max(farthest, float(np.linalg.norm(along, axis=-1).max()))
    return farthest


def swing_load(reference: ReferenceTrajectory, record: SimulationRecord, scene: Scene) -> float:
    """Longest time (s) for which a contact carries load in the middle half of a planned swing.

    Around lift-off and touchdown, a loaded contact is merely late or early.
    """
    n = min(len(record.feet), reference.planned)
    loaded, longest = loaded_contacts(record, scene)[:n], 0
    for contact in range(loaded.shape[1]):
        for first, end in _runs(~reference.active[:n, contact]):
            quarter = (end - first) // 4
            longest = max(longest, int(loaded[first + quarter : end - quarter, contact].sum()))
    return longest * reference.period


def force_error(reference: ReferenceTrajectory, record: SimulationRecord) -> float | None:
    """Root mean square over the plan of the error of all contact forces, N; None without contacts."""
    n = min(len(record.force), reference.planned)
    difference = record.force[:n, :, :3] - reference.f[:n, :, :3]
    return float(np.sqrt((difference**2).sum(axis=(1, 2)).mean())) if difference.size else None


@dataclass(frozen=True)
class FallTest:
    """Whether a robot falls; on a fixed base it falls only if its simulation diverges."""

    scene: Scene

    def first(
        self, record: SimulationRecord, timeline: ContactTimeline, rows: slice, wanted: np.ndarray
    ) -> Fall | None:
        """The first fall in some rows of a record, where the robot should be at ``wanted`` (n, nq)."""
        t, robot, height, falls = timeline.t[rows], self.scene.robot, self.scene.site.height, []
        touched = record.touched[rows]
        if len(touched) < len(t):
            falls.append(Fall(time=float(t[len(touched)]), why="the simulation diverged"))
        if robot.base != "fixed" and len(touched):
            q = self.scene.coordinates.from_mujoco(record.qpos[rows])[: len(touched)]
            actual, planned = base_poses(robot.model, q), base_poses(robot.model, wanted[: len(q)])
            dropped = (planned[:, :, 3] - actual[:, :, 3]) @ upwards(robot.model) > LARGEST_DROP * height
            cosine = np.einsum("nij,nij->n", planned[:, :, :3], actual[:, :, :3])
            turned = np.arccos(np.clip((cosine - 1) / 2, -1, 1)) > LARGEST_TILT
            for flags, why in (
                (touched, "a link touches the ground"),
                (dropped & (height > 0), "the base has dropped"),
                (turned, "the base has turned over"),
            ):
                if flags.any():
                    falls.append(Fall(time=float(t[int(flags.argmax())]), why=why))
        return min(falls, key=lambda fall: fall.time, default=None)
