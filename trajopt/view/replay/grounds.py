"""The ground of every solution of a scene: its plane, how deep drawn feet reach below it, its drawing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trajopt.solution.descriptions import terrain_of
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.view.replay.ground import draw_plane, sky_and_light
from trajopt.view.replay.runs import GAP, DrawnSolution
from trajopt.view.replay.surfaces import Touch, depth_below_contacts, drawn_plane, plane_of, touches_of
from trajopt.view.replay.terrain import MARGIN, draw_terrain


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnGround:
    """plane: the terrain's, of uneven ground a level one. seen: as drawn, ``drop`` m below the contacts.

    elsewhere: touches of other surfaces than the terrain. uneven: the terrain, if it is no plane.
    """

    plane: Surface
    seen: Surface
    drop: float
    elsewhere: list[Touch]
    uneven: PiecewiseTerrain | SmoothTerrain | None


def grounds_of(runs: list[DrawnSolution], size: float) -> list[DrawnGround]:
    """The ground under each solution, in its own world; ``size`` m is the robots' extent.

    Where several stand on one plane it is drawn at the height of the smallest feet: the others' sink into
    it by as much as their tips are rounder.
    """
    grounds = [_ground_of(run, size) for run in runs]
    plane = grounds[0].plane
    shared = [g for g in grounds if g.uneven is None and g.drop > 0 and g.plane.same_plane(plane)]
    if not shared:
        return grounds
    highest = min(shared, key=lambda ground: ground.drop)
    return [replace(g, seen=highest.seen, drop=highest.drop) if g in shared else g for g in grounds]


def _ground_of(run: DrawnSolution, size: float) -> DrawnGround:
    standing, elsewhere = touches_of(run)
    terrain, plane = terrain_of(run.solution.meta.get("terrain")), plane_of(run.solution)
    if isinstance(terrain, PiecewiseTerrain | SmoothTerrain):
        drop = depth_below_contacts(standing, run, size)
        return DrawnGround(plane=plane, seen=plane, drop=drop, elsewhere=elsewhere, uneven=terrain)
    seen = drawn_plane(standing, run, size) if standing else _under(run, plane)
    drop = max(plane.height - seen.height, 0.0) if standing else 0.0
    return DrawnGround(plane=plane, seen=seen, drop=drop, elsewhere=elsewhere, uneven=None)


def _under(run: DrawnSolution, plane: Surface) -> Surface:
    """The plane; under a robot without contacts as low as it hangs, which a pendulum does."""
    if run.solution.contact_frames or not run.cloud.size:
        return plane
    depth = min(float((run.cloud @ plane.normal).min()) - plane.height, 0.0)
    return Surface(point=plane.point + depth * plane.normal, normal=plane.normal)


def draw_grounds(
    vis: Any, runs: list[DrawnSolution], grounds: list[DrawnGround], box: np.ndarray, size: float
) -> Surface:
    """Draw sky, light and each different ground; returns the first solution's plane.

    ``box`` (2, 3) m is around everything. Runs on planes share the first one; uneven ground of runs that are
    moved aside goes with them, and no further than half way to the next.
    """
    sky_and_light(vis, size)
    told: list[Any] = []
    for run, ground in zip(runs, grounds, strict=True):
        aside = any(other.shift.any() for other in runs)
        described = (run.solution.meta.get("terrain"), run.shift.tolist())
        if ground.uneven is None:
            described = ("plane", [])
        if described in told:
            continue
        told.append(described)
        if ground.uneven is None:
            draw_plane(vis, box, ground.seen, size)
            continue
        margin = np.full(2, MARGIN * size)
        if aside:
            margin[runs[-1].shift[:2] != 0] = GAP * size / 2
        own = np.array([run.cloud.min(axis=0), run.cloud.max(axis=0)]) if aside else box
        draw_terrain(run.node if aside else vis, ground.uneven, own, margin, ground.drop, size)
    return grounds[0].seen
