"""Moments of a motion (a phase's start, middle or end, the motion's end), and targets to reach at them.

Terms state their targets in `Term.targets`; footholds of the schedule are targets too. In files they are a
list of {frame, position, rotation, q, phase}, with null for what a target lacks. The moment is the start of
the phase, or another ``fraction`` of it if that key is there. Without a phase it is the end of the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from trajopt.arguments import Array3, Array33, Fraction, checked
from trajopt.errors import InputError, shown
from trajopt.kinds import ArrayShape

KEYS = ("frame", "position", "rotation", "q", "phase")
FRACTION = "fraction"


@checked
@dataclass(frozen=True)
class Moment:
    """A fraction of a phase's duration; by default the end of the motion.

    `start_of`, `middle_of` and `end_of` create the usual ones. The end of a phase is the start of the next
    one, unless that begins with an impact: then it is just before the impact.

    Args:
        phase: name of the phase; None for the end of the motion.
        fraction: of the phase's duration, 0 to 1.

    Raises:
        InputError: for a fraction out of range or without a phase, and a phase that is not a name.
    """

    phase: str | None = None
    fraction: Fraction = 1.0

    def __post_init__(self) -> None:
        if self.phase == "":
            raise InputError("phase of a moment is ''", "allowed: the name of a phase")
        if self.phase is None and self.fraction != 1:
            raise InputError(
                f"fraction of a moment is {shown(self.fraction)} of {self._phase}",
                "allowed: 0 to 1 of a phase",
            )

    @property
    def _phase(self) -> str:
        return "the motion" if self.phase is None else f"phase '{self.phase}'"

    def __str__(self) -> str:
        words = {0.0: "start", 0.5: "middle", 1.0: "end"}
        return f"{words.get(self.fraction, f'{100 * self.fraction:g} %')} of {self._phase}"


END = Moment()


@checked
def start_of(phase: str) -> Moment:
    """The start of a phase, just after its impact where it begins with one."""
    return Moment(phase, 0.0)


@checked
def middle_of(phase: str) -> Moment:
    """The middle of a phase; in ballistic flight this is the apex, if it ends as high as it began."""
    return Moment(phase, 0.5)


@checked
def end_of(phase: str) -> Moment:
    """The end of a phase, just before the next one's impact where that begins with one."""
    return Moment(phase, 1.0)


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """A goal for a frame or the whole robot at one moment.

    Args:
        frame: name of a frame, which has a position, a rotation or both; None for a configuration.
        position: position of the frame's origin in the world (3,), m.
        rotation: axes of the frame in the world (3, 3).
        q: configuration (nq,), for a target without a frame.
        at: the moment at which the goal holds.

    Raises:
        InputError: for other shapes, or an empty target.
    """

    frame: str | None = None
    position: Array3 | None = None
    rotation: Array33 | None = None
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
        """Rebuild a target from the output of `describe`. Raises `InputError`."""
        if not isinstance(described, dict) or set(described) - {FRACTION} != set(KEYS):
            raise InputError(f"a target is described by {shown(described)}", f"allowed: {', '.join(KEYS)}")
        phase = described["phase"]
        at = END if phase is None else Moment(phase, described.get(FRACTION, 0.0))
        return cls(**{name: described[name] for name in KEYS[:-1]}, at=at)
