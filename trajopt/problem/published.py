"""Problems with published optima."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from trajopt.arguments import checked
from trajopt.problem.problem import Problem


@checked
@dataclass(frozen=True)
class PublishedOptimum:
    """A problem with a published optimum.

    ``build`` returns the problem and ``value`` computes the published ``quantity`` from a solution. The
    ``published`` value is from ``source`` and holds to a relative ``tolerance``. ``name`` is for tables.
    """

    name: str
    build: Callable[[], Problem]
    value: Callable[[Any], float]
    quantity: str
    published: float
    tolerance: float
    source: str
