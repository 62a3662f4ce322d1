"""What a tracker reports of its ticks: requested forces and goals, counts and times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from trajopt.control.contact_forces import ActiveContact
from trajopt.control.inverse_dynamics import RELAXED
from trajopt.control.tasks import CenterOfMassTask, FrameTask, Task


@dataclass(frozen=True, kw_only=True)
class TickRequest:
    """Contact forces and goals of one tick, in the world.

    ``forces`` (nc, 6) act on the robot at the contact frames, N and N m; they are zero for inactive contacts.
    ``com`` (3,) is the goal of the centre of mass, m; NaN if no task leads it, as in flight. ``feet`` (nc, 3)
    are goals of the contact frames in the air, m; NaN for contacts that stand.
    """

    forces: np.ndarray
    com: np.ndarray
    feet: np.ndarray

    @classmethod
    def none(cls, contacts: int) -> TickRequest:
        """The request of a tick without a program, for a robot with that number of contacts."""
        return cls(
            forces=np.zeros((contacts, 6)), com=np.full(3, np.nan), feet=np.full((contacts, 3), np.nan)
        )

    @classmethod
    def of(
        cls,
        forces: np.ndarray,
        contacts: Sequence[ActiveContact],
        tasks: Sequence[Task],
        com: np.ndarray,
        frames: Sequence[int],
    ) -> TickRequest:
        """The request of a program.

        Args:
            forces: forces of the active contacts (nc', 6), N and N m.
            contacts: the active contacts.
            tasks: tasks of the program.
            com: planned centre of mass (3,), m, the goal of a `CenterOfMassTask`.
            frames: frames of all contacts (nc,).
        """
        request = cls.none(len(frames))
        for contact, force in zip(contacts, forces, strict=True):
            request.forces[contact.number] = force
        for task in tasks:
            if isinstance(task, CenterOfMassTask):
                request.com[:] = com
            elif isinstance(task, FrameTask) and task.frame in frames:
                request.feet[frames.index(int(task.frame))] = task.pose.translation
        return request


@dataclass
class TickCounts:
    """Ticks so far, their number by what was relaxed (see `RELAXED`), solver iterations, and times in s.

    ``slack`` is the largest one of a `TickResult`.
    """

    ticks: int = 0
    relaxed: list[int] = field(default_factory=lambda: [0] * len(RELAXED))
    iterations: int = 0
    slack: float = 0.0
    times: list[float] = field(default_factory=list)
