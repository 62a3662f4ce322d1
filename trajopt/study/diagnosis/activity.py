"""Which limits are active, where, for how long, and how much the objective would gain without them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from trajopt.study.diagnosis.names import NlpNames, Site
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
    rows = [(names.block(row), names.row_sites[row]) for row in range(t.n_rows)]
    bounds = [(BOUNDS, site) for site in names.unknown_sites]
    bounded = (np.isfinite(t.lower_x) | np.isfinite(t.upper_x)) & ~snapshot.fixed
    found = _grouped(
        snapshot,
        [(*rows[row], names.row(row).about, row) for row in np.flatnonzero(snapshot.row_side).tolist()],
        snapshot.row_side,
        snapshot.row_multiplier,
        np.minimum(snapshot.g - t.lower_g, t.upper_g - snapshot.g),
        {rows[row] for row in np.flatnonzero(~snapshot.equality).tolist()},
    )
    found += _grouped(
        snapshot,
        [(*bounds[i], str(names.unknown_labels[i]), i) for i in np.flatnonzero(snapshot.bound_side).tolist()],
        snapshot.bound_side,
        snapshot.bound_multiplier,
        np.minimum(snapshot.x - t.lower_x, t.upper_x - snapshot.x),
        {bounds[i] for i in np.flatnonzero(bounded).tolist()},
    )
    return sorted(found, key=lambda limit: (-(limit.multiplier or 0.0), -limit.places))


def _grouped(
    snapshot: Snapshot,
    active: list[tuple[str, Site, str, int]],
    side: np.ndarray,
    multiplier: np.ndarray | None,
    slack: np.ndarray,
    stated: set[tuple[str, Site]],
) -> list[ActiveLimit]:
    """Active limits (block, place, subject, index) by phase; ``stated``: blocks and places that have some."""
    names, strict = snapshot.names, snapshot.strict(slack, multiplier)
    of = Counter((block, names.phase_index(site.stage)) for block, site in stated)
    groups: dict[tuple[str, str, int, int], list[tuple[int, Site]]] = {}
    for block, site, about, index in active:
        key = (block, about, int(side[index]), names.phase_index(site.stage))
        groups.setdefault(key, []).append((index, site))
    found = []
    for (block, about, sign, phase), members in groups.items():
        sites = {site for _, site in members}
        times = [names.time(site) for site in sites]
        largest = at = None
        if multiplier is not None:
            index, site = max(members, key=lambda member: abs(multiplier[member[0]]))
            largest, at = abs(float(multiplier[index])), names.time(site)
        found.append(
            ActiveLimit(
                block=block,
                about=about,
                side=SIDES[sign],
                phase=names.layout.schedule.phases[phase].name,
                places=len(sites),
                of=of[block, phase],
                strict=int(sum(strict[index] for index, _ in members)),
                duration=float(sum(_share(names, site) for site in sites)),
                first=min(times),
                last=max(times),
                multiplier=largest,
                at=at,
            )
        )
    return found


def _share(names: NlpNames, site: Site) -> float:
    """Time for which a point stands, s: its weight in the integral; none for a node."""
    if site.point < 0:
        return 0.0
    step = float(names.times[site.stage + 1] - names.times[site.stage])
    return step * float(names.layout.scheme_of(names.phase_index(site.stage)).b1[site.point])
