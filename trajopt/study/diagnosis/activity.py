"""Which limits are active, where, for how long, and how much the objective would gain without them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trajopt.study.diagnosis.names import Names, Site
from trajopt.study.diagnosis.snapshot import Snapshot

BOUNDS = "bounds"
SIDES = {-1: "lower", 1: "upper"}


@dataclass(frozen=True, kw_only=True)
class ActiveLimit:
    """One limit in one phase: ``block`` and ``about`` name it, ``side`` is lower or upper.

    places: number of points or nodes at which it is active, of ``of`` at which it is stated; strict: at how
    many of them its multiplier says so. duration: s, of those at points. first, last: s. multiplier: the
    largest, scaled units, at the time ``at``; None without multipliers.
    """

    block: str
    about: str
    side: str
    phase: str
    places: int
    of: int
    strict: int
    duration: float
    first: float
    last: float
    multiplier: float | None
    at: float | None

    @property
    def weak(self) -> bool:
        """Whether nowhere a multiplier says that it matters."""
        return self.multiplier is not None and self.strict == 0

    def __str__(self) -> str:
        span = f"t = {self.first:.3f} s" if self.places == 1 else f"t = {self.first:.3f} to {self.last:.3f} s"
        long = f", {self.duration:.3f} s in all" if self.duration else ""
        paid = "" if self.multiplier is None else f"; multiplier up to {self.multiplier:.1e}"
        weak = " (weakly)" if self.weak else ""
        return (
            f"{self.block} [{self.about}] at its {self.side} bound{weak}, phase '{self.phase}', "
            f"{self.places} of {self.of} places, {span}{long}{paid}"
        )


def active_limits(snapshot: Snapshot) -> list[ActiveLimit]:
    """All active inequalities and bounds, those with the largest multipliers first."""
    t, names = snapshot.transcription, snapshot.names
    rows = np.flatnonzero(snapshot.row_side)
    slack = np.minimum(snapshot.g - t.lower_g, t.upper_g - snapshot.g)
    entries = [
        (names.block(row), names.row(row).about, int(snapshot.row_side[row]), names.row_sites[row])
        for row in rows.tolist()
    ]
    strict = snapshot.strict(slack, snapshot.row_multiplier)[rows]
    paid = _of(snapshot.row_multiplier, rows)
    found = _grouped(names, entries, paid, strict, _stated_rows(snapshot))
    unknowns = np.flatnonzero(snapshot.bound_side)
    slack = np.minimum(snapshot.x - t.lower_x, t.upper_x - snapshot.x)
    entries = [
        (BOUNDS, str(names.unknown_labels[i]), int(snapshot.bound_side[i]), names.unknown_sites[i])
        for i in unknowns.tolist()
    ]
    strict = snapshot.strict(slack, snapshot.bound_multiplier)[unknowns]
    paid = _of(snapshot.bound_multiplier, unknowns)
    found += _grouped(names, entries, paid, strict, _stated_bounds(snapshot))
    return sorted(found, key=lambda limit: (-(limit.multiplier or 0.0), -limit.places))


def _of(multiplier: np.ndarray | None, which: np.ndarray) -> np.ndarray | None:
    return None if multiplier is None else np.abs(multiplier[which])


def _stated_rows(snapshot: Snapshot) -> dict[tuple[str, int], int]:
    """Number of places in a phase at which a block has inequalities."""
    names = snapshot.names
    places = {(names.block(row), names.row_sites[row]) for row in np.flatnonzero(~snapshot.equality).tolist()}
    return _counted(names, places)


def _stated_bounds(snapshot: Snapshot) -> dict[tuple[str, int], int]:
    t, names = snapshot.transcription, snapshot.names
    bounded = (np.isfinite(t.lower_x) | np.isfinite(t.upper_x)) & ~snapshot.fixed
    places = {(BOUNDS, names.unknown_sites[i]) for i in np.flatnonzero(bounded).tolist()}
    return _counted(names, places)


def _counted(names: Names, places: Iterable[tuple[str, Site]]) -> dict[tuple[str, int], int]:
    found: dict[tuple[str, int], int] = {}
    for block, site in places:
        key = (block, names.phase_index(site.stage))
        found[key] = found.get(key, 0) + 1
    return found


def _grouped(
    names: Names,
    entries: list[tuple[str, str, int, Site]],
    multiplier: np.ndarray | None,
    strict: np.ndarray,
    stated: dict[tuple[str, int], int],
) -> list[ActiveLimit]:
    groups: dict[tuple[str, str, int, int], list[int]] = {}
    for index, (block, about, side, site) in enumerate(entries):
        groups.setdefault((block, about, side, names.phase_index(site.stage)), []).append(index)
    found = []
    for (block, about, side, phase), members in groups.items():
        sites = [entries[index][3] for index in members]
        times = [names.time(site) for site in sites]
        largest = None if multiplier is None else members[int(np.argmax(multiplier[members]))]
        found.append(
            ActiveLimit(
                block=block,
                about=about,
                side=SIDES[side],
                phase=names.layout.schedule.phases[phase].name,
                places=len(set(sites)),
                of=stated[block, phase],
                strict=int(strict[members].sum()),
                duration=float(sum(_share(names, site) for site in set(sites))),
                first=min(times),
                last=max(times),
                multiplier=None if multiplier is None or largest is None else float(multiplier[largest]),
                at=None if largest is None else names.time(entries[largest][3]),
            )
        )
    return found


def _share(names: Names, site: Site) -> float:
    """Time for which a point stands, s: its weight in the integral; none for a node."""
    if site.point < 0:
        return 0.0
    step = float(names.times[site.stage + 1] - names.times[site.stage])
    return step * float(names.layout.scheme_of(names.phase_index(site.stage)).b1[site.point])
