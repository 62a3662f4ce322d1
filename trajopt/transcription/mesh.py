"""The mesh of a transcription: for each phase a scheme and the widths of its intervals.

Phases may differ in scheme and degree, and intervals of one phase in width: refinement (``refine``) splits
intervals where the error between points is large, or raises the degree of a phase.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from trajopt.arguments import Positive, checked
from trajopt.errors import InputError, shown
from trajopt.transcription.schemes import Scheme, scheme

# Tolerance on the sum of the widths, which equals one up to rounding.
SUM_ERROR = 1e-9


@checked
@dataclass(frozen=True, kw_only=True)
class PhaseMesh:
    """A scheme by name, and the widths of a phase's intervals as fractions of its duration, in time order.

    Raises InputError for an unknown scheme, or widths that are not positive or do not add up to one.
    """

    scheme: str
    widths: tuple[Positive, ...]

    def __post_init__(self) -> None:
        scheme(self.scheme)
        if abs(sum(self.widths) - 1) > SUM_ERROR:
            raise InputError(
                f"widths of a phase's intervals are {shown(self.widths)}", "allowed: positive, 1 in sum"
            )

    @classmethod
    def uniform(cls, scheme: str, count: int) -> PhaseMesh:
        """``count`` intervals of equal width."""
        return cls(scheme=scheme, widths=(1.0 / count,) * count)

    @cached_property
    def method(self) -> Scheme:
        """The scheme."""
        return scheme(self.scheme)

    @cached_property
    def fractions(self) -> tuple[float, ...]:
        """Nodes as fractions of the phase's duration, from 0 to 1."""
        if self.is_uniform:
            return equal_fractions(self.count)
        return (0.0, *np.cumsum(self.widths)[:-1].tolist(), 1.0)

    @property
    def is_uniform(self) -> bool:
        """Whether all intervals have the same width."""
        return len(set(self.widths)) == 1

    @property
    def count(self) -> int:
        """Number of intervals."""
        return len(self.widths)

    def split(self, parts: Sequence[int]) -> PhaseMesh:
        """The mesh with interval i cut into ``parts[i]`` equal ones."""
        widths = [width / n for width, n in zip(self.widths, parts, strict=True) for _ in range(n)]
        return PhaseMesh(scheme=self.scheme, widths=tuple(widths))

    def with_scheme(self, name: str) -> PhaseMesh:
        """The same intervals with another scheme."""
        return PhaseMesh(scheme=name, widths=self.widths)

    def describe(self) -> dict[str, Any]:
        """JSON-able description; equal intervals are described by their number alone."""
        return {"scheme": self.scheme, "intervals": self.count if self.is_uniform else list(self.widths)}

    @classmethod
    def from_description(cls, given: Mapping[str, Any]) -> PhaseMesh:
        """Rebuild the mesh from the output of `describe`."""
        intervals = given["intervals"]
        if isinstance(intervals, int):
            return cls.uniform(given["scheme"], intervals)
        return cls(scheme=given["scheme"], widths=tuple(intervals))


@checked
@dataclass(frozen=True, kw_only=True)
class Mesh:
    """The mesh of every phase of a schedule, in time order."""

    phases: tuple[PhaseMesh, ...]

    def __post_init__(self) -> None:
        if not self.phases:
            raise InputError("a mesh has no phase", "allowed: a PhaseMesh for every phase")

    @classmethod
    def uniform(cls, transcription: str, counts: Sequence[int]) -> Mesh:
        """Equal intervals in each phase.

        ``transcription`` names one scheme for all phases, or one per phase separated by commas. Raises
        InputError for another number of schemes, or an unknown one.
        """
        names = [name.strip() for name in transcription.split(",")]
        if len(names) not in (1, len(counts)):
            raise InputError(
                f"transcription '{transcription}' names {len(names)} schemes for {len(counts)} phases",
                "allowed: one scheme, or one for each phase",
            )
        names = names * len(counts) if len(names) == 1 else names
        return cls(phases=tuple(map(PhaseMesh.uniform, names, counts)))

    @property
    def transcription(self) -> str:
        """Name of the scheme; if there are several, one per phase, separated by commas."""
        names = [phase.scheme for phase in self.phases]
        return names[0] if len(set(names)) == 1 else ",".join(names)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of intervals of each phase."""
        return tuple(phase.count for phase in self.phases)

    def describe(self) -> list[dict[str, Any]]:
        """JSON-able description, one entry per phase."""
        return [phase.describe() for phase in self.phases]


def equal_fractions(count: int) -> tuple[float, ...]:
    """Nodes of ``count`` equal intervals as fractions, from 0 to 1."""
    return tuple(i / count for i in range(count + 1))
