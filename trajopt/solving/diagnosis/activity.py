"""Active limits: where, for how long, and how much the objective would gain without them."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from trajopt.solving.diagnosis.snapshot import Snapshot
from trajopt.transcription.names import NlpNames, StagePoint

SIDES = {-1: "lower", 1: "upper"}


@dataclass(frozen=True, kw_only=True)
class ActiveLimit:
    """One limit in one phase: ``block`` and ``about`` name it, ``side`` is lower or upper.

    places, of: number of points or nodes at which it is active, and at which it is imposed.
    strict: number of rows or bounds that are strictly active by their multipliers.
    duration: time in s at active points. first, last: times of the first and last active place, s.
    multiplier: the largest one, scaled units, at time ``at``; None without multipliers.
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
        """Whether the limit is strictly active nowhere."""
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
    """Return all active inequalities and bounds, those with the largest multipliers first."""
    names, lower, upper = snapshot.names, snapshot.lower, snapshot.upper
    limited = (np.isfinite(lower) | np.isfinite(upper)) & (lower != upper)
    stated = {(names.block(i), names.sites[i]) for i in np.flatnonzero(limited).tolist()}
    of = Counter((block, names.phase_index(site.stage)) for block, site in stated)
    groups: dict[tuple[str, str, int, int], list[int]] = {}
    for index in np.flatnonzero(snapshot.side).tolist():
        name = names.row(index)
        key = (name.block, name.about, int(snapshot.side[index]), names.phase_index(name.site.stage))
        groups.setdefault(key, []).append(index)
    limits = [_limit(snapshot, *key, of[key[0], key[3]], members) for key, members in groups.items()]
    return sorted(limits, key=lambda limit: (-(limit.multiplier or 0.0), -limit.places))


def _limit(
    snapshot: Snapshot, block: str, about: str, side: int, phase: int, of: int, members: list[int]
) -> ActiveLimit:
    """Summarise one limit in one phase that is active at ``members``, rows or bounds."""
    names, multiplier = snapshot.names, snapshot.multiplier
    sites = {names.sites[index] for index in members}
    times = [names.time(site) for site in sites]
    largest = at = None
    if multiplier is not None:
        index = max(members, key=lambda member: abs(multiplier[member]))
        largest, at = abs(float(multiplier[index])), names.time(names.sites[index])
    return ActiveLimit(
        block=block,
        about=about,
        side=SIDES[side],
        phase=names.layout.schedule.phases[phase].name,
        places=len(sites),
        of=of,
        strict=int(snapshot.strict[members].sum()),
        duration=float(sum(_share(names, site) for site in sites)),
        first=min(times),
        last=max(times),
        multiplier=largest,
        at=at,
    )


def _share(names: NlpNames, site: StagePoint) -> float:
    """Return the time that a point represents, s: its quadrature weight; 0 for a node."""
    if site.point < 0:
        return 0.0
    step = float(names.times[site.stage + 1] - names.times[site.stage])
    return step * float(names.layout.scheme_of(names.phase_index(site.stage)).b1[site.point])
