"""Ends of a half: rows of the whole robot's end, in the combinations that a mirrored motion can meet or miss.

`TerminalState` asks N^T D^-1 e = 0 of the error e, N the directions that contacts leave free. Where the
goal's contacts are not where the motion's are, what that means depends on N. So a half asks the same of the
whole robot's error: of its rows A = N^T D^-1 E, with E from the half's rates to the whole's, the left
singular vectors of the r largest singular values, r the number of directions that the half's own contacts
leave free.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from trajopt.reduced.scenes.reduction import whole_place
from trajopt.reduced.scenes.view import WholeNodeTerm, WholeView
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Rows
from trajopt.terms.node_interfaces import NodePlace
from trajopt.terms.terminal import TerminalRest, TerminalState, free_directions


@dataclass(frozen=True, kw_only=True, eq=False)
class HalfEnd(WholeNodeTerm):
    """`TerminalState` or `TerminalRest` of the whole robot on the motion of its half."""

    term: TerminalState | TerminalRest

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        there, own = whole_place(place, self.reduction), Units(self.reduction.whole)
        combined = context.parameter(self._combinations(place, there, own)).T
        found = self.term.rows(WholeView(context, self.reduction), own, there)
        return Rows.create(ca.mtimes(combined, found.expression), 0, 0, 1.0)

    def _combinations(self, place: NodePlace, there: NodePlace, own: Units) -> np.ndarray:
        reduction, q = self.reduction, np.asarray(self.term.q, dtype=float)
        free = free_directions(reduction.whole, q, there.phase.contacts)
        small = free_directions(reduction.small, reduction.drop_q(q), place.phase.contacts)
        left = np.linalg.svd(free.T @ (reduction.rates / own.position[:, None]))[0]
        return np.asarray(left[:, : small.shape[1]])
