"""Targets: positions, orientations and postures to reach at single moments, as recorded in a solution.

Terms give theirs by `Term.targets`; footholds of the schedule are targets too. In files they are a list
of {frame, position, rotation, q, phase}, each null where there is none; the moment is the start of the phase,
or, with a key more, another ``fraction`` of it. Without a phase it is the end of the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape
from trajopt.schedule.moment import END, Moment

KEYS = ("frame", "position", "rotation", "q", "phase")
FRACTION = "fraction"


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """A goal for a frame or the whole robot at one moment.

    Args:
        frame: name of a frame, which has a position, a rotation or both; None for a configuration.
        position: of the frame in the world (3,), m.
        rotation: of the frame in the world (3, 3).
        q: configuration (nq,), without a frame.
        at: the moment at which the goal holds.

    Raises:
        InputError: for other shapes, or an empty target.
    """

    frame: str | None = None
    position: Annotated[np.ndarray, ArrayShape((3,))] | None = None
    rotation: Annotated[np.ndarray, ArrayShape((3, 3))] | None = None
    q: Annotated[np.ndarray, ArrayShape((None,))] | None = None
    at: Moment = END

    def __post_init__(self) -> None:
        if (self.frame is None) != (self.position is None and self.rotation is None):
            raise InputError("a target has a frame without a place, or a place without a frame", "both")
        if self.frame is None and self.q is None:
            raise InputError("a target is empty", "a frame's place, or a configuration q")

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        entries = {name: getattr(self, name) for name in KEYS[:-1]}
        known = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in entries.items()}
        later = self.at.phase is not None and self.at.fraction > 0
        return {**known, "phase": self.at.phase, **({FRACTION: self.at.fraction} if later else {})}

    @classmethod
    def from_description(cls, described: Any) -> Target:
        """The target that ``describe`` wrote. Raises `InputError`."""
        if not isinstance(described, dict) or set(described) - {FRACTION} != set(KEYS):
            raise InputError(f"a target is described by {described!r}", f"allowed: {', '.join(KEYS)}")
        phase = described["phase"]
        at = END if phase is None else Moment(phase, described.get(FRACTION, 0.0))
        return cls(**{name: described[name] for name in KEYS[:-1]}, at=at)
