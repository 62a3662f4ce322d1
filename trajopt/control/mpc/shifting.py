"""Warm starts of a horizon: the last iterate, shifted in time.

Within a pattern of contacts the variables of the present mode are resampled at the new times of its nodes.
When the pattern changes, variables, multipliers and slacks of the modes that remain move to their new places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from trajopt import _engine
from trajopt.control.mpc.horizon import Horizon
from trajopt.control.mpc.plans import SolverSettings


def resampled(horizon: Horizon, x: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Resample the variables of the first n intervals from node times ``old`` to ``new`` (n + 1,), s.

    All nodes but the last are interpolated linearly, and held after the last old time. An interval takes its
    other variables from the old interval at its midpoint. The next solver step removes the remaining defects.
    """
    layout, count, moved = horizon.layout, len(old) - 1, x.copy()
    nodes = np.array([x[layout.node(k)] for k in range(count + 1)])
    controls = np.array([x[layout.window(k)][layout.forms[k].size :] for k in range(count)])
    n_rotation = 4 * layout.coordinates.n_rotations
    for k in range(count):
        place = min(int(np.searchsorted(old, new[k], side="right")) - 1, count - 1)
        share = min((new[k] - old[place]) / (old[place + 1] - old[place]), 1.0)
        node = (1 - share) * nodes[place] + share * nodes[place + 1]
        if n_rotation:
            node[:n_rotation] /= np.linalg.norm(node[:n_rotation])
        moved[layout.node(k)] = node
        near = min(int(np.searchsorted(old, (new[k] + new[k + 1]) / 2, side="right")) - 1, count - 1)
        moved[layout.window(k)][layout.forms[k].size :] = controls[near]
    return moved


@dataclass(frozen=True)
class IterateMap:
    """Map of variables, rows and slacks from one horizon to another, as indices of source and target."""

    variables: tuple[np.ndarray, np.ndarray]
    rows: tuple[np.ndarray, np.ndarray]
    slacks: tuple[np.ndarray, np.ndarray]
    kept: int

    @classmethod
    def of(cls, last: Horizon, horizon: Horizon) -> IterateMap:
        """Map the leading phases that equal those of the last horizon from its second on, else its first."""
        kept, shift = 0, 1
        old, new = last.pattern, horizon.pattern
        for shift in (1, 0):
            kept = 0
            for i in range(min(len(old.contacts) - shift, len(new.contacts))):
                if old.contacts[i + shift] != new.contacts[i] or old.intervals[i + shift] != new.intervals[i]:
                    break
                kept += 1
            if kept:
                break
        if not kept:
            empty = np.zeros(0, dtype=int)
            return cls((empty, empty), (empty, empty), (empty, empty), 0)
        first = int(last.layout.intervals_of(shift)[0])
        stages = sum(new.intervals[:kept])
        source, target = [], []
        for k in range(stages):
            source.append(np.arange(*last.layout.window(first + k).indices(last.layout.n_unknowns)))
            target.append(np.arange(*horizon.layout.window(k).indices(horizon.layout.n_unknowns)))
        source.append(np.arange(*last.layout.node(first + stages).indices(last.layout.n_unknowns)))
        target.append(np.arange(*horizon.layout.node(stages).indices(horizon.layout.n_unknowns)))
        rows = _rows_alike(last, horizon, first, stages)
        slack_of = [np.full(each.transcription.n_rows, -1) for each in (last, horizon)]
        for each, slacks in zip((last, horizon), slack_of, strict=True):
            slacks[each.unequal] = np.arange(len(each.unequal))
        both = (slack_of[0][rows[0]] >= 0) & (slack_of[1][rows[1]] >= 0)
        kept_slacks = slack_of[0][rows[0]][both], slack_of[1][rows[1]][both]
        return cls((np.concatenate(source), np.concatenate(target)), rows, kept_slacks, stages)

    def apply(
        self,
        last: Horizon,
        horizon: Horizon,
        iterate: _engine.Iterate,
        solver: SolverSettings,
        gliding: Callable[[Horizon, np.ndarray, int], np.ndarray],
    ) -> _engine.Iterate:
        """The iterate of the new horizon; its new part starts from ``gliding`` at the end of what is kept."""
        scale = horizon.transcription.scale
        old = np.zeros(len(scale))
        old[self.variables[1]] = iterate["x"][self.variables[0]]
        end = (old * scale)[horizon.layout.node(self.kept)]
        if not self.kept:
            end = (last.transcription.scale * iterate["x"])[last.layout.node(last.layout.n_stages)]
        x = gliding(horizon, end, self.kept)
        x[self.variables[1]] = iterate["x"][self.variables[0]]
        fresh = solver.fresh(horizon, x)
        fresh["y"][self.rows[1]] = iterate["y"][self.rows[0]]
        bounds: tuple[Literal["lower_x", "upper_x"], ...] = ("lower_x", "upper_x")
        for name in bounds:
            fresh[name][self.variables[1]] = iterate[name][self.variables[0]]
        of_slacks: tuple[Literal["s", "lower_s", "upper_s"], ...] = ("s", "lower_s", "upper_s")
        for own in of_slacks:
            fresh[own][self.slacks[1]] = iterate[own][self.slacks[0]]
        fresh["barrier"] = iterate["barrier"]
        fresh["regularization"] = iterate["regularization"]
        return fresh


def _rows_alike(last: Horizon, horizon: Horizon, first: int, stages: int) -> tuple[np.ndarray, np.ndarray]:
    """Matching rows of the last horizon, from stage ``first`` on, and of this one, up to ``stages``."""

    def blocks(each: Horizon, shift: int) -> dict[tuple[int, int, str], np.ndarray]:
        rows = each.transcription.rows
        at = rows.stage - shift
        key = np.stack([at, rows.point, rows.block], axis=1)
        inside = np.flatnonzero((at >= 0) & (at <= stages))
        order = inside[np.lexsort(key[inside].T[::-1])]
        cuts = np.flatnonzero(np.any(np.diff(key[order], axis=0) != 0, axis=1)) + 1
        return {
            (int(part[0, 0]), int(part[0, 1]), rows.names[int(part[0, 2])]): where
            for part, where in zip(np.split(key[order], cuts), np.split(order, cuts), strict=True)
        }

    old, new = blocks(last, first), blocks(horizon, 0)
    pairs = [(old[key], where) for key, where in new.items() if key in old and len(old[key]) == len(where)]
    none = [np.zeros(0, dtype=int)]
    return np.concatenate([a for a, _ in pairs] or none), np.concatenate([b for _, b in pairs] or none)
