"""Figures of a check on bodies: depth of links in the ground, distances to obstacles and each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajopt.collision.description import RobotShapes
from trajopt.collision.near import CollisionScene
from trajopt.motion.solution import Solution
from trajopt.motion.traces import Trace, Traces

# Distances of pairs are exact within this distance beyond their margin, m; further away only for the nearest
# pair of a kind.
RANGE = 0.02
KINDS = ("ground", "obstacle", "self")


@dataclass(frozen=True, kw_only=True)
class FileBodies:
    """Collision scenes of a solution: its links' shapes, and the wider capsules of older files.

    kinds: (n,) kind of the second body of each pair of all scenes.
    margins: (n,) distances that the pairs must keep, m.
    within: (n,) distances beyond which values are only lower bounds, m.
    present: (n_phases, n) phases in which both bodies are there.
    """

    scenes: tuple[CollisionScene, ...]
    kinds: np.ndarray
    margins: np.ndarray
    within: np.ndarray
    present: np.ndarray

    @classmethod
    def of(cls, plan: Solution) -> tuple[FileBodies, Traces]:
        """Return a plan's bodies and figures at its samples; the nearest pair of each kind is exact."""
        bodies, capsules = (
            scene(plan.model) for scene in (plan.description.body_scene, plan.description.capsule_scene)
        )
        scenes = [scene for scene in (bodies, capsules) if scene is not None]
        margins = [
            plan.description.body_margins(scene) if scene is bodies else np.zeros(len(scene.pairs))
            for scene in scenes
        ]
        asked = np.concatenate([np.zeros(0), *margins])
        shapes, phases = plan.description.bodies or RobotShapes(), range(len(plan.description.phase_names))
        there = [shapes.present(scene.pairs, phases) for scene in scenes]
        measured = cls(
            scenes=tuple(scenes),
            kinds=np.array([kind for part in scenes for kind in _kinds(part)], dtype=object),
            margins=asked,
            within=np.full(len(asked), RANGE + asked.max(initial=0.0)),
            present=np.concatenate([np.zeros((len(phases), 0), dtype=bool), *there], axis=1),
        )
        distances = measured.distances(plan)
        reach = measured.within.copy()
        for kind in KINDS:
            of_kind = measured.kinds == kind
            short = distances[:, of_kind] - asked[of_kind]
            if short.size and short.min() > RANGE:  # only bounds: the nearest pair is at most as far as here
                row = np.unravel_index(short.argmin(), short.shape)[0]
                exact = np.concatenate([scene.distances(plan.q[row])[0] for scene in scenes])
                exact[~measured.present[plan.phase[row]]] = np.inf
                reach[of_kind] = (exact - asked)[of_kind].min() + asked.max(initial=0.0)
        if (reach > measured.within).any():
            measured = replace(measured, within=reach)
            distances = measured.distances(plan)
        return measured, measured._traces(distances)

    def distances(self, plan: Solution) -> np.ndarray:
        """Return the distances (K, n) m of all pairs at samples; infinite where a body is not carried."""
        parts = np.split(self.within, np.cumsum([len(scene.pairs) for scene in self.scenes])[:-1])
        columns = [scene.distances(plan.q, part) for scene, part in zip(self.scenes, parts, strict=False)]
        every = np.concatenate([np.zeros((len(plan.q), 0)), *columns], axis=1)
        return np.where(self.present[plan.phase], every, np.inf)

    def traces(self, plan: Solution) -> Traces:
        """Return the depth in the ground and the distances, m, of all pairs at the samples of ``plan``."""
        return self._traces(self.distances(plan))

    def _traces(self, distances: np.ndarray) -> Traces:
        pairs = [" and ".join(pair) for scene in self.scenes for pair in scene.pairs]

        def of(values: np.ndarray, columns: np.ndarray, margin: bool = True) -> Trace:
            asked, names = values[:, columns], [pairs[i] for i in np.flatnonzero(columns)]
            return Trace.of(asked, np.isfinite(asked), names, margin=margin)

        return {
            "link_depth": of(-distances, self.kinds == "ground", margin=False),
            "obstacle_distance": of(distances, self.kinds == "obstacle"),
            "self_distance": of(distances, self.kinds == "self"),
            "clearance_margin": of(distances - self.margins, self.margins > 0),
        }


def _kinds(scene: CollisionScene) -> list[str]:
    """Return the kind of the second body of every pair."""
    kinds = ["ground"] * scene.n_ground + ["obstacle"] * (scene.n_outer - scene.n_ground)
    return kinds + ["self"] * (len(scene.pairs) - scene.n_outer)


def missing_shapes(plan: Solution) -> tuple[str, ...]:
    """Describe what is unknown about a motion because link shapes in its file are missing or doubtful."""
    bodies = plan.description.bodies
    if bodies is None or not bodies.shapes:
        return ("no shapes of links are in the file: their depth in the ground and distances are not known",)
    doubts = bodies.doubts(plan.model)
    if bodies.missing:
        return (f"without shapes of links that could not be read: {'; '.join(bodies.missing)}", *doubts)
    return doubts
