"""Limits as lines in a panel of several joints: those that a joint's own values come near."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import style
from trajopt.view.plotting.draw import LIMIT, fit, set_range

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A limit is shown where values come as near as this part of it, else it would only flatten the curves.
NEAR = 0.75


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A quantity's least and largest allowed value, infinite where there is none, its values and colour.

    ``values`` (n,) are all that are drawn of it, NaN among them.
    """

    lower: float
    upper: float
    values: np.ndarray
    colour: str

    @property
    def near(self) -> tuple[float, ...]:
        """The limits that values come near: `NEAR` of the way from the middle of what is allowed, or zero."""
        finite = self.values[np.isfinite(self.values)]
        if not finite.size:
            return ()
        both = np.isfinite(self.lower) and np.isfinite(self.upper)
        middle = (self.lower + self.upper) / 2 if both else 0.0
        reached = {self.lower: middle - finite.min(), self.upper: finite.max() - middle}
        return tuple(
            limit
            for limit, way in reached.items()
            if np.isfinite(limit) and way >= NEAR * abs(limit - middle)
        )


def limit_lines(axes: Axes, found: Sequence[Limit], least: float = 0.0) -> None:
    """Fit the vertical axis, with the limits that values come near; those all curves share are hatched."""
    low, high = fit(axes, least=least)
    near = [value for limit in found for value in limit.near]
    set_range(axes, min([low, *near]), max([high, *near]), least)
    shared = len(found) > 1 and len({(limit.lower, limit.upper) for limit in found}) == 1
    if not shared:
        for limit in found:
            for value in limit.near:
                axes.axhline(value, **{**LIMIT, "color": limit.colour}, zorder=2)
        return
    bottom, top = axes.get_ylim()
    for value in set(near):
        axes.axhline(value, **LIMIT, zorder=2)
        side = bottom if value == found[0].lower else top
        axes.axhspan(*sorted((value, side)), facecolor="none", edgecolor=style.GREY, hatch="////", lw=0)
