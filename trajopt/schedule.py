"""Contact-mode schedules: who is in contact, and for how long."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from trajopt.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A stretch of motion with a constant set of active contacts.

    ``duration`` in s; ``contacts`` are names of the robot's contacts; ``footholds`` optionally gives
    the world position (3,) in m at which a contact that begins with this phase must land (without
    it the contact only has to touch the terrain).
    """

    name: str
    duration: float
    contacts: tuple[str, ...] = ()
    footholds: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.duration) and self.duration > 0):
            raise InputError(
                f"duration of phase '{self.name}' is {self.duration:g} s", "allowed: finite and > 0"
            )
        if len(set(self.contacts)) != len(self.contacts):
            raise InputError(f"phase '{self.name}' names a contact twice: {', '.join(self.contacts)}")
        unknown = set(self.footholds) - set(self.contacts)
        if unknown:
            raise InputError(
                f"phase '{self.name}' has a foothold for {', '.join(sorted(unknown))}",
                "allowed: contacts that are active in the phase",
            )
        points = {name: np.array(point, dtype=float) for name, point in self.footholds.items()}
        for name, point in points.items():
            if point.shape != (3,) or not np.all(np.isfinite(point)):
                raise InputError(
                    f"foothold of '{name}' in phase '{self.name}' is {point}", "allowed: 3 finite numbers, m"
                )
            point.setflags(write=False)
        object.__setattr__(self, "contacts", tuple(self.contacts))
        object.__setattr__(self, "footholds", MappingProxyType(points))


@dataclass(frozen=True)
class Schedule:
    """Phases in time order."""

    phases: tuple[Phase, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "phases", tuple(self.phases))
        if not self.phases:
            raise InputError("the schedule has no phase", "allowed: at least one phase")

    @property
    def duration(self) -> float:
        """Total duration in s."""
        return sum(phase.duration for phase in self.phases)

    def new_contacts(self, index: int) -> tuple[str, ...]:
        """Contacts that begin with phase ``index``; those of the first phase hold already."""
        if index == 0:
            return ()
        before = self.phases[index - 1].contacts
        return tuple(name for name in self.phases[index].contacts if name not in before)

    def intervals(self, total: int) -> tuple[int, ...]:
        """Share ``total`` intervals among the phases by duration, at least one each.

        Raises InputError when there are fewer intervals than phases.
        """
        if total < len(self.phases):
            raise InputError(
                f"{total} intervals for {len(self.phases)} phases", f"allowed: at least {len(self.phases)}"
            )
        ideal = np.array([phase.duration for phase in self.phases]) / self.duration * total
        counts = np.maximum(1, np.floor(ideal).astype(int))
        while counts.sum() < total:
            counts[np.argmax(ideal / counts)] += 1
        while counts.sum() > total:
            spare = np.where(counts > 1, counts / ideal, -np.inf)
            counts[np.argmax(spare)] -= 1
        return tuple(int(count) for count in counts)


@dataclass(frozen=True, kw_only=True)
class FlatGround:
    """Horizontal ground with Coulomb friction: ``height`` in m, ``friction`` coefficient."""

    height: float = 0.0
    friction: float = 0.7

    def __post_init__(self) -> None:
        if not (math.isfinite(self.friction) and self.friction >= 0):
            raise InputError(f"friction coefficient is {self.friction:g}", "allowed: finite and >= 0")
        if not math.isfinite(self.height):
            raise InputError(f"ground height is {self.height:g} m", "allowed: finite")

    def describe(self) -> dict[str, object]:
        """JSON-able description for a solution file."""
        return {"kind": "flat", "height": self.height, "normal": [0.0, 0.0, 1.0], "friction": self.friction}
