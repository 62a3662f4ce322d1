"""Records of a simulation, period by period."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from trajopt.control.tick_request import TickCounts, TickRequest
from trajopt.motion.consistency import rows_of


@dataclass(frozen=True, kw_only=True)
class RequestRecord:
    """Requests of a whole-body controller in n periods: rows of `TickRequest`.

    forces: (n, nc, 6) N and N m. com: (n, 3) m. feet: (n, nc, 3) m.
    """

    forces: np.ndarray
    com: np.ndarray
    feet: np.ndarray

    @classmethod
    def empty(cls, periods: int, contacts: int) -> RequestRecord:
        """A record in which every row is `TickRequest.none`."""
        rows = [TickRequest.none(contacts)] * periods
        return cls(
            **{field.name: np.array([getattr(row, field.name) for row in rows]) for field in fields(cls)}
        )

    def note(self, k: int, request: TickRequest) -> None:
        """Record the request of period ``k``."""
        self.forces[k], self.com[k], self.feet[k] = request.forces, request.com, request.feet


@dataclass(frozen=True, kw_only=True)
class SimulationRecord:
    """States, forces and events at the starts of n periods, and the final state, in MuJoCo's coordinates.

    Args:
        qpos, qvel, qacc: (n + 1, nq'), (n + 1, nv), (n, nv).
        torque, saturated, friction: (n, nu) of the drives, whether they are clipped, and their friction.
        force: (n, nc, 6) of the surroundings on contacts, world axes, at the frames' origins.
        feet, turns: (n, nc, 3) m and (n, nc, 3, 3) of the contact frames.
        touched, hit: (n,) a link touches ground, an obstacle. counts, requests: of a whole-body controller.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    qacc: np.ndarray
    torque: np.ndarray
    saturated: np.ndarray
    friction: np.ndarray
    force: np.ndarray
    feet: np.ndarray
    turns: np.ndarray
    touched: np.ndarray
    hit: np.ndarray
    counts: TickCounts | None = None
    requests: RequestRecord | None = None

    def until(self, count: int) -> SimulationRecord:
        """The periods before period ``count``, at whose state MuJoCo has diverged.

        That state and the step to it are left out; a record that ends at once keeps one period at rest.
        """
        rows = max(count - 1, 1)
        if count <= 1:
            self.qpos[1], self.qvel[1] = self.qpos[0], self.qvel[0]
        names = [field.name for field in fields(self) if field.name not in ("counts", "requests")]
        cut = {name: getattr(self, name)[: rows + (name in ("qpos", "qvel"))] for name in names}
        asked = None if self.requests is None else rows_of(self.requests, slice(rows))
        return replace(self, **cut, requests=asked)
