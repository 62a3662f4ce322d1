"""Where terms are evaluated, the kinds of control input, and the symbols of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal, get_args

import casadi as ca


class Place(Enum):
    """Where a term is evaluated."""

    POINT = "collocation point"
    NODE = "node"
    IMPACT = "impact"


Actuation = Literal["torque", "acceleration", "velocity"]
ACTUATIONS: tuple[Actuation, ...] = get_args(Actuation)


@dataclass(frozen=True)
class FrameSymbols:
    """Symbols of one frame, world axes: placement (m), velocity and classical acceleration.

    The last two have 6 entries: linear, angular.
    """

    rotation: ca.SX  # (3, 3)
    position: ca.SX  # (3,)
    velocity: ca.SX  # (6,)
    acceleration: ca.SX  # (6,)

    @classmethod
    def create(cls, frame: str) -> FrameSymbols:
        """Fresh symbols for ``frame``."""
        return cls(
            ca.SX.sym(f"R_{frame}", 3, 3),
            ca.SX.sym(f"p_{frame}", 3),
            ca.SX.sym(f"v_{frame}", 6),
            ca.SX.sym(f"a_{frame}", 6),
        )

    def stacked(self) -> ca.SX:
        """All entries in one column (24,), columns of the rotation first."""
        return ca.vertcat(ca.vec(self.rotation), self.position, self.velocity, self.acceleration)
