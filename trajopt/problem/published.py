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

    name: for tables. build: of the problem. value: what was published, of a solution. quantity: what that is.
    published: its value. tolerance: relative. source: of the value.
    """

    name: str
    build: Callable[[], Problem]
    value: Callable[[Any], float]
    quantity: str
    published: float
    tolerance: float
    source: str
