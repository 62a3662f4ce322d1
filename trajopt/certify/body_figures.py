"""Figures of a check about bodies: depth of links in the ground, distances from obstacles and each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajopt.certify.traces import Trace, Traces
from trajopt.robot.collision.near import CollisionScene
from trajopt.solution.descriptions import bodies_of, body_margins_of, body_scene_of, scene_of_meta
from trajopt.solution.solution import Solution

# Links are looked for within these distances, m, one after the other: most motions come within the first.
RANGES = (0.05, 0.2, 1.0, np.inf)


@dataclass(frozen=True, kw_only=True)
class FileBodies:
    """Scenes of the bodies in a solution's meta.

    Of the shapes in ``meta["bodies"]``, and of the capsules in ``meta["collision"]``, which are wider, or are
    all that an older file has. Beyond ``within`` m distances are lower bounds. margins: (n,) m that the
    pairs of all scenes shall keep.
    """

    scenes: tuple[CollisionScene, ...]
    margins: np.ndarray
    within: float

    @classmethod
    def of(cls, plan: Solution) -> FileBodies:
        """The bodies of a plan, with distances that are exact for the nearest pair of each kind."""
        bodies = body_scene_of(plan.model, plan.meta)
        scenes, margins = [], []
        for scene in (bodies, scene_of_meta(plan.model, plan.meta.get("collision"))):
            if scene is not None and scene.pairs:
                scenes.append(scene)
                known = scene is bodies
                margins.append(body_margins_of(plan.meta, scene) if known else np.zeros(len(scene.pairs)))
        asked = np.concatenate([np.zeros(0), *margins])
        for within in RANGES:
            found = cls(scenes=tuple(scenes), margins=asked, within=within)
            worst = [trace.worst() for trace in found.traces(plan).values()]
            if all(abs(value) + asked.max(initial=0.0) <= within for value, _, _ in filter(None, worst)):
                break
        return found

    def traces(self, plan: Solution) -> Traces:
        """Depth in the ground, and least distances, m, of every pair at the samples of ``plan``."""
        values = [scene.distances(plan.q, self.within) for scene in self.scenes]
        pairs = [pair for scene in self.scenes for pair in scene.pairs]
        kinds = [kind for scene in self.scenes for kind in _kinds(scene)]
        distances = np.concatenate([np.zeros((plan.n_samples, 0)), *values], axis=1)

        def of(kind: str) -> tuple[np.ndarray, list[str]]:
            columns = [column for column, own in enumerate(kinds) if own == kind]
            return distances[:, columns], [" and ".join(pairs[column]) for column in columns]

        depth, links = of("ground")
        parts = {"obstacle_distance": of("obstacle"), "self_distance": of("self")}
        wanted = np.flatnonzero(self.margins)
        names = [" and ".join(pairs[column]) for column in wanted]
        parts["clearance_margin"] = distances[:, wanted] - self.margins[wanted], names
        return {
            "link_depth": Trace.of(-depth, True, links),
            **{name: Trace.of(apart, True, names, margin=True) for name, (apart, names) in parts.items()},
        }


def _kinds(scene: CollisionScene) -> list[str]:
    """Of every pair what the second body is."""
    kinds = ["ground"] * scene.n_ground + ["obstacle"] * (scene.n_outer - scene.n_ground)
    return kinds + ["self"] * (len(scene.pairs) - scene.n_outer)


def missing_shapes(plan: Solution) -> tuple[str, ...]:
    """What is not known of a motion because shapes of links are not in its file."""
    bodies = bodies_of(plan.meta.get("bodies"))
    if bodies is None or not bodies.shapes:
        return ("no shapes of links are in the file: their depth in the ground and distances are not known",)
    if bodies.missing:
        return (f"without shapes of links that could not be read: {'; '.join(bodies.missing)}",)
    return ()
