"""Rank of the contact Jacobian along the motion: redundancy of contacts from physics alone.

Contact wrenches are not unique if contact rows depend on each other, in any transcription. A rank that
changes along a phase is due to a posture, such as a straight leg or an axis through two contacts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.certify.contact.contact_response import ContactRank, contact_rank, contact_response, mass_factor
from trajopt.certify.contact.contact_set import AXES, ContactSet, contact_kinematics
from trajopt.errors import TrajoptError
from trajopt.motion.solution import Solution
from trajopt.robot.contact import Contact
from trajopt.transcription.transcription import Transcription

# Condition number of the contacts in a nearly singular posture, such as a leg straight within a thousandth.
NEARLY_SINGULAR = 1e3


@dataclass(frozen=True, kw_only=True)
class ContactDependency:
    """Rows (contact and axis) that depend on each other, and the number of redundant ones."""

    rows: tuple[str, ...]
    excess: int

    def __str__(self) -> str:
        return f"{self.excess} too many among {', '.join(self.rows)}"


@dataclass(frozen=True, kw_only=True)
class PhaseContacts:
    """Contacts of one phase over its samples.

    rows: number of rows. least, most: extreme ranks. condition: the worst one, at time ``at`` in s.
    dependencies: at the sample of least rank. left_out: rows that the transcription leaves out as redundant.
    """

    phase: str
    rows: int
    least: int
    most: int
    condition: float
    at: float
    dependencies: tuple[ContactDependency, ...]
    left_out: tuple[str, ...]

    @property
    def redundant(self) -> bool:
        """Whether rows depend on each other throughout the phase."""
        return self.most < self.rows

    @property
    def singular(self) -> bool:
        """Whether some postures of the phase are singular or nearly so."""
        return self.least < self.most or self.condition > NEARLY_SINGULAR

    def __str__(self) -> str:
        if not self.rows:
            return "no contact rows"
        span = f"{self.least}" if self.least == self.most else f"{self.least} to {self.most}"
        groups = "; ".join(map(str, self.dependencies))
        text = f"{self.rows} contact rows of rank {span}, condition up to {self.condition:.1e}"
        text += f" at t = {self.at:.3f} s" + (f": {groups}" if groups else "")
        return text + (f"; left out: {', '.join(self.left_out)}" if self.left_out else "")


def phase_contacts(transcription: Transcription, solution: Solution) -> Iterator[PhaseContacts]:
    """Yield the contact ranks of every phase at the collocation points of its motion.

    Samples that are not finite are skipped, as are phases without others.
    """
    layout, model = transcription.layout, solution.model
    finite = np.isfinite(solution.q).all(axis=1) & solution.collocation
    for index, phase in enumerate(layout.schedule.phases):
        contacts = layout.touching[index]
        samples = [k for k in solution.phases[index] if finite[k]]
        levers = [transcription.problem.levers[index].get(contact.name) for contact in contacts]
        found = ((k, _rank(model, contacts, solution.q[k], levers)) for k in samples)
        known = [(k, rank) for k, rank in found if rank is not None]
        ranks = [rank for _, rank in known]
        if not contacts or not ranks:
            continue
        absent = _absent_rows(contacts)
        least = min(ranks, key=lambda rank: rank.delassus)
        worst = int(np.argmax([rank.condition for rank in ranks]))
        yield PhaseContacts(
            phase=phase.name,
            rows=least.rows - len(absent),
            least=least.delassus,
            most=max(rank.delassus for rank in ranks),
            condition=ranks[worst].condition,
            at=float(solution.t[known[worst][0]]),
            dependencies=tuple(
                ContactDependency(rows=group.rows, excess=group.excess)
                for group in least.dependencies
                if not set(group.rows) <= absent
            ),
            left_out=tuple(transcription.redundant.get(phase.name, ())),
        )


def _absent_rows(contacts: tuple[Contact, ...]) -> set[str]:
    """Return the names of rows that contacts do not impose because they are within a plane."""
    return {
        f"{contact.name} {AXES[row]}"
        for contact in contacts
        for row in range(3 if contact.kind == "point" else 6)
        if row not in contact.rows
    }


def _rank(
    model: pin.Model, contacts: tuple[Contact, ...], q: np.ndarray, levers: Sequence[np.ndarray | None] = ()
) -> ContactRank | None:
    try:
        active = ContactSet.of(model, contacts, levers=levers)
        data = model.createData()
        lower = mass_factor(pin.crba(model, data, q))
        rows = contact_kinematics(model, data, q, np.zeros(model.nv), active)
        return contact_rank(active, rows.jacobian, contact_response(lower, active, rows.jacobian))
    except (TrajoptError, np.linalg.LinAlgError):  # a massless body, or an iterate far from any motion
        return None
