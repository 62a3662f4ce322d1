"""Explain infeasibility in words: which rows must be violated, and which rows they conflict with."""

from dataclasses import dataclass

import numpy as np

from trajopt.solvers.elastic import CLEAR_VIOLATION, ElasticPoint
from trajopt.transcription.names import NlpNames, StagePoint
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import Transcription

# Rows of the motion itself: they propagate a conflict along the motion, and are blamed last.
MOTION = ("defect", "base_dynamics", "contact_acceleration", "contact_velocity", "impact_dynamics")
# Multipliers below NOISE are numerical noise; sums below the fraction LEAST_PART of the largest are ignored.
NOISE, LEAST_PART = 1e-4, 0.1
NAMED_MEMBERS = 6


@dataclass(frozen=True, kw_only=True)
class ConflictMember:
    """The rows or bounds of one block and subject in one phase.

    Args:
        what: Block and subject.
        amount: Unavoidable violation in natural units; 0 for rows that conflict with a violated one.
        weight: Sum of the multipliers over the phase.
        place: Where the violation or the multiplier is largest.
    """

    what: str
    phase: str
    amount: float
    weight: float
    place: str

    @property
    def block(self) -> str:
        """Name of the block."""
        return self.what.split(" [", 1)[0]

    def __str__(self) -> str:
        if self.amount > 0:
            return f"{self.what} lacks {self.amount:.2e} at {self.place}"
        return f"{self.what} in phase '{self.phase}' (weight {self.weight:.2f}, most at {self.place})"


def rows_of_motion(t: Transcription) -> np.ndarray:
    """Return a mask (n_rows,) of the rows of the motion itself."""
    return np.isin(t.rows.block, [i for i, name in enumerate(t.rows.names) if name in MOTION])


def why_infeasible(nlp: Nlp, point: ElasticPoint) -> str:
    """Say in one line what is violated at a point of least violation, where, and what conflicts with it.

    Rows of the motion are named only if no others are violated: they propagate what goals demand. Flights of
    a fixed duration are named too.
    """
    t = nlp.transcription
    names = NlpNames(nlp, point.x)
    give = np.where(point.gives > min(CLEAR_VIOLATION, point.gives.max()), point.gives, 0.0)
    missed = members_giving(names, give)
    giving = str(next((each for each in missed if each.block not in MOTION), missed[0]))
    limits = np.concatenate(
        [t.lower_g < t.upper_g, t.lower_x < t.upper_x]
    )  # equalities are left out: goals propagate what they demand
    members = members_against(names, give, np.where(limits, point.weights, 0.0))[:1]
    return "".join([giving, *(f", against {one.what}" for one in members), _fixed_flights(t)])


def _fixed_flights(t: Transcription) -> str:
    """Name flights of a fixed duration, which a goal may be too high for: no row states their ballistics."""
    phases = t.layout.schedule.phases if t.problem.robot.base != "fixed" else ()
    flights = [each for each in phases if not each.contacts and each.duration_bounds is None]
    named = ", ".join(f"'{flight.name}' of {flight.duration:g} s" for flight in flights)
    return f"; flight {named}: a rise h and a fall f take sqrt(2 h / g) + sqrt(2 f / g)" if named else ""


def members_giving(names: NlpNames, give: np.ndarray) -> tuple[ConflictMember, ...]:
    """Return the rows with a violation ``give`` (n_rows,) above zero, one member a subject and phase."""
    parties: dict[tuple[str, str], ConflictMember] = {}
    for row in np.argsort(-give)[: np.count_nonzero(give)].tolist():
        name, amount = names.row(row), float(give[row])
        what, phase, place = name.what, names.phase(name.site.stage), names.place(name.site)
        member = ConflictMember(what=what, phase=phase, amount=amount, weight=1.0, place=place)
        parties.setdefault((what, phase), member)
    return tuple(parties.values())[:NAMED_MEMBERS]


def members_against(names: NlpNames, give: np.ndarray, weights: np.ndarray) -> tuple[ConflictMember, ...]:
    """Return the limits, bounds and goals with the largest multipliers, summed over each phase.

    ``give`` is as in `members_giving`; ``weights`` (n_rows + n_unknowns,) are multipliers of rows and bounds.
    """
    giving = {names.block(row) for row in np.flatnonzero(give).tolist()}
    entries_of: dict[tuple[str, str], list[tuple[float, StagePoint]]] = {}
    for index in np.flatnonzero(np.abs(weights) > NOISE).tolist():
        if names.block(index) not in (*MOTION, *giving):
            name = names.row(index)
            key = (name.what, names.phase(name.site.stage))
            entries_of.setdefault(key, []).append((abs(float(weights[index])), name.site))
    sums = {key: sum(weight for weight, _ in entries) for key, entries in entries_of.items()}
    largest = max(sums.values(), default=0.0)
    order = sorted((key for key in sums if sums[key] > LEAST_PART * largest), key=lambda key: -sums[key])
    return tuple(
        ConflictMember(
            what=what,
            phase=phase,
            amount=0.0,
            weight=sums[what, phase],
            place=names.place(max(entries_of[what, phase], key=lambda entry: entry[0])[1]),
        )
        for what, phase in order[:NAMED_MEMBERS]
    )
