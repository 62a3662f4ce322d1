"""Figures of a check about bodies: depth of links in the ground, distances from obstacles and each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajopt.collision.near import CollisionScene
from trajopt.motion.traces import Trace, Traces
from trajopt.solution.solution import Solution

# Pairs within this distance beyond their margin, m, are measured, and farther ones where no pair of their
# kind is so near.
NEAR = 0.02
KINDS = ("ground", "obstacle", "self")


@dataclass(frozen=True, kw_only=True)
class FileBodies:
    """Scenes of the bodies of a solution.

    Of the shapes of its links, and of capsules, which are wider, and all that an older file has.
    kinds: (n,) of the pairs of all scenes, what the second body is. margins: (n,) m that they shall keep.
    within: (n,) m, beyond which distances are lower bounds.
    """

    scenes: tuple[CollisionScene, ...]
    kinds: np.ndarray
    margins: np.ndarray
    within: np.ndarray

    @classmethod
    def of(cls, plan: Solution) -> tuple[FileBodies, Traces]:
        """The bodies of a plan and their figures at its samples; of each kind the nearest pair is exact."""
        bodies, capsules = (
            scene(plan.model) for scene in (plan.description.body_scene, plan.description.capsule_scene)
        )
        scenes = [scene for scene in (bodies, capsules) if scene is not None]
        margins = [
            plan.description.body_margins(scene) if scene is bodies else np.zeros(len(scene.pairs))
            for scene in scenes
        ]
        asked = np.concatenate([np.zeros(0), *margins])
        measured = cls(
            scenes=tuple(scenes),
            kinds=np.array([kind for part in scenes for kind in _kinds(part)], dtype=object),
            margins=asked,
            within=np.full(len(asked), NEAR + asked.max(initial=0.0)),
        )
        distances = measured.distances(plan.q)
        reach = measured.within.copy()
        for kind in KINDS:
            of_kind = measured.kinds == kind
            short = distances[:, of_kind] - asked[of_kind]
            if short.size and short.min() > NEAR:  # all are bounds: the nearest pair is no farther than here
                at = plan.q[np.unravel_index(short.argmin(), short.shape)[0]]
                exact = np.concatenate([scene.distances(at)[0] for scene in scenes])
                reach[of_kind] = (exact - asked)[of_kind].min() + asked.max(initial=0.0)
        if (reach > measured.within).any():
            measured = replace(measured, within=reach)
            distances = measured.distances(plan.q)
        return measured, measured._traces(distances)

    def distances(self, q: np.ndarray) -> np.ndarray:
        """Distances (K, n) m of all pairs at configurations (K, nq)."""
        parts = np.split(self.within, np.cumsum([len(scene.pairs) for scene in self.scenes])[:-1])
        columns = [scene.distances(q, part) for scene, part in zip(self.scenes, parts, strict=False)]
        return np.concatenate([np.zeros((len(q), 0)), *columns], axis=1)

    def traces(self, plan: Solution) -> Traces:
        """Depth in the ground, and least distances, m, of every pair at the samples of ``plan``."""
        return self._traces(self.distances(plan.q))

    def _traces(self, distances: np.ndarray) -> Traces:
        pairs = [" and ".join(pair) for scene in self.scenes for pair in scene.pairs]

        def of(values: np.ndarray, columns: np.ndarray, margin: bool = True) -> Trace:
            return Trace.of(
                values[:, columns], True, [pairs[i] for i in np.flatnonzero(columns)], margin=margin
            )

        return {
            "link_depth": of(-distances, self.kinds == "ground", margin=False),
            "obstacle_distance": of(distances, self.kinds == "obstacle"),
            "self_distance": of(distances, self.kinds == "self"),
            "clearance_margin": of(distances - self.margins, self.margins > 0),
        }


def _kinds(scene: CollisionScene) -> list[str]:
    """Of every pair what the second body is."""
    kinds = ["ground"] * scene.n_ground + ["obstacle"] * (scene.n_outer - scene.n_ground)
    return kinds + ["self"] * (len(scene.pairs) - scene.n_outer)


def missing_shapes(plan: Solution) -> tuple[str, ...]:
    """What is not known of a motion because shapes of links are not in its file, or are doubtful."""
    bodies = plan.description.bodies
    if bodies is None or not bodies.shapes:
        return ("no shapes of links are in the file: their depth in the ground and distances are not known",)
    doubts = bodies.doubts(plan.model)
    if bodies.missing:
        return (f"without shapes of links that could not be read: {'; '.join(bodies.missing)}", *doubts)
    return doubts
