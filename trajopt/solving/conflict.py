"""Rows that contradict each other, in words: which have to give way, and which stand against them."""

from dataclasses import dataclass

import numpy as np

from trajopt.solvers.elastic import CLEAR, ElasticPoint
from trajopt.transcription.names import NlpNames, Site
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import Transcription

# Rows of the motion itself: they pass a conflict on from place to place, and give way last.
MOTION = ("defect", "base_dynamics", "contact_acceleration", "contact_velocity", "impact_dynamics")
# Multipliers below the first are noise of the interior-point method; sums of multipliers below this fraction
# of the largest are ignored.
NOISE, PART = 1e-4, 0.1
NAMED = 6


@dataclass(frozen=True, kw_only=True)
class ConflictMember:
    """Rows or bounds of one block and subject in one phase.

    amount: the unavoidable violation, natural units; 0 for rows in conflict with it.
    weight: multipliers, added up over the phase. place: of the largest.
    """

    what: str
    phase: str
    amount: float
    weight: float
    place: str

    @property
    def block(self) -> str:
        """Their block."""
        return self.what.split(" [", 1)[0]

    def __str__(self) -> str:
        if self.amount > 0:
            return f"{self.what} lacks {self.amount:.2e} at {self.place}"
        return f"{self.what} in phase '{self.phase}' (weight {self.weight:.2f}, most at {self.place})"


def rows_of_motion(t: Transcription) -> np.ndarray:
    """Which rows are of the motion itself (n_rows,)."""
    return np.isin(t.rows.block, [i for i, name in enumerate(t.rows.names) if name in MOTION])


def why_infeasible(nlp: Nlp, point: ElasticPoint) -> str:
    """In one line: what is missed at a point of least violation, where, and what stands against it.

    Of rows of the motion itself only where no others are missed: they pass on what goals ask.
    """
    t = nlp.transcription
    names = NlpNames(nlp, point.x)
    give = np.where(point.gives > min(CLEAR, point.gives.max()), point.gives, 0.0)
    missed = members_giving(names, give)
    giving = str(next((each for each in missed if each.block not in MOTION), missed[0]))
    limits = np.concatenate(
        [t.lower_g < t.upper_g, t.lower_x < t.upper_x]
    )  # goals only pass on what they ask
    members = members_against(names, give, np.where(limits, point.weights, 0.0))[:1]
    return "".join([giving, *(f", against {one.what}" for one in members)])


def members_giving(names: NlpNames, give: np.ndarray) -> tuple[ConflictMember, ...]:
    """Rows that give way by more than zero, ``give`` (n_rows,), the worst of each block and subject first."""
    parties: dict[tuple[str, str], ConflictMember] = {}
    for row in np.argsort(-give)[: np.count_nonzero(give)].tolist():
        name, amount = names.row(row), float(give[row])
        what, phase, place = name.what, names.phase(name.site.stage), names.place(name.site)
        member = ConflictMember(what=what, phase=phase, amount=amount, weight=1.0, place=place)
        parties.setdefault((what, phase), member)
    return tuple(parties.values())[:NAMED]


def members_against(names: NlpNames, give: np.ndarray, weights: np.ndarray) -> tuple[ConflictMember, ...]:
    """Limits, bounds and goals with the largest multipliers, added up over time.

    give: as in `members_giving`. weights (n_rows + n_unknowns,): multipliers of rows, then of bounds.
    """
    giving = {names.block(row) for row in np.flatnonzero(give).tolist()}
    entries_of: dict[tuple[str, str], list[tuple[float, Site]]] = {}
    for index in np.flatnonzero(np.abs(weights) > NOISE).tolist():
        if names.block(index) not in (*MOTION, *giving):
            name = names.row(index)
            key = (name.what, names.phase(name.site.stage))
            entries_of.setdefault(key, []).append((abs(float(weights[index])), name.site))
    sums = {key: sum(weight for weight, _ in entries) for key, entries in entries_of.items()}
    largest = max(sums.values(), default=0.0)
    order = sorted((key for key in sums if sums[key] > PART * largest), key=lambda key: -sums[key])
    return tuple(
        ConflictMember(
            what=what,
            phase=phase,
            amount=0.0,
            weight=sums[what, phase],
            place=names.place(max(entries_of[what, phase], key=lambda entry: entry[0])[1]),
        )
        for what, phase in order[:NAMED]
    )
