"""What a tick of the tracker asks for: contact forces, goals of the centre of mass and of swinging feet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajopt.control.contact_forces import ActiveContact
from trajopt.control.tasks import CenterOfMassTask, FrameTask, Task


@dataclass(frozen=True, kw_only=True)
class TickRequest:
    """Contact forces and goals of one tick, in the world.

    forces: (nc, 6) of the surroundings on the robot at the contact frames, N and N m; zero where none.
    com: (3,) where the centre of mass should be, m; NaN where no task leads it, as in flight.
    feet: (nc, 3) where the frames of contacts in the air should be, m; NaN of those that stand.
    """

    forces: np.ndarray
    com: np.ndarray
    feet: np.ndarray

    @classmethod
    def none(cls, contacts: int) -> TickRequest:
        """The request of a tick without a program, for a robot with so many contacts."""
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
            forces: (nc', 6) of the active contacts, N and N m.
            contacts: these contacts.
            tasks: of the program.
            com: planned centre of mass (3,), m, which a `CenterOfMassTask` leads to.
            frames: of all contacts (nc,).
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
