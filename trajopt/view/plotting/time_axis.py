"""The time axis of a panel: phases shaded and named, impacts, ticks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajopt.view.plotting import style
from trajopt.view.plotting.page import PlotRow, Tracks
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Inches of a letter in the names of phases, and their font.
PHASE_LETTER, PHASE_FONT = 0.05, 6.0
# Width in inches of a tick label.
TICK = 0.5


def over_time(axes: Axes, tracks: Tracks, *, labelled: bool, strip: float) -> None:
    """Shade phases, mark impacts and the other solutions' phase changes, and set the time axis."""
    from matplotlib.ticker import MaxNLocator

    start = min(track.phases[0].start for track in tracks)
    end = max(track.phases[-1].end for track in tracks)
    axes.set_xlim(start, end)
    count = max(2, round(axes.get_position().width * style.WIDTH / TICK))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=count, steps=[1, 2, 2.5, 5, 10]))
    for number, phase in enumerate(tracks[0].phases):
        if number % 2:
            axes.axvspan(phase.start, phase.end, color=style.BAND, linewidth=0, zorder=0)
    for track in tracks[1:]:
        for phase in track.phases[1:]:
            axes.axvline(phase.start, color=style.GREY, linewidth=0.5, linestyle=":", zorder=1)
    for track in tracks:
        for time in impact_times(track):
            axes.axvline(time, color=style.RED, linewidth=0.7, linestyle=(0, (1, 1)), zorder=1)
    if labelled:
        axes.set_xlabel("time t [s]", labelpad=1.0)
    else:
        axes.tick_params(labelbottom=False)
    if strip:
        _phase_names(axes, tracks, strip)


def impact_times(track: Track) -> list[float]:
    """Times of the impacts, s."""
    index = track.solution.impact_index
    return [] if index is None else [float(track.solution.t[row]) for row in index]


def phase_strip(row: PlotRow, tracks: Tracks) -> float:
    """Height in inches of the phase names above a row: one line, vertical, or none for a single phase."""
    phases = tracks[0].phases
    if len(phases) < 2:
        return 0.0
    width = (style.WIDTH - row.left - row.right) / sum(panel.wide for panel in row.panels)
    if len(row.panels) > 1 or _names_fit(tracks, width):
        return 0.13
    return 0.06 + PHASE_LETTER * max(len(phase.name) for phase in phases)


def _rooms(tracks: Tracks, width: float) -> list[float]:
    """The width of each phase on axes of a ``width``, inches."""
    phases = tracks[0].phases
    whole = max(track.phases[-1].end for track in tracks) - phases[0].start
    return [(phase.end - phase.start) / whole * width for phase in phases]


def _names_fit(tracks: Tracks, width: float) -> bool:
    """Whether each name of a phase fits beside its neighbours on axes of a width in inches."""
    need = [PHASE_LETTER * len(phase.name) for phase in tracks[0].phases]
    return all(one <= space for one, space in zip(need, _rooms(tracks, width), strict=True))


def _phase_names(axes: Axes, tracks: Tracks, strip: float) -> None:
    """Names above their phases: horizontal, or vertical if there is room for that."""
    width = axes.get_position().width * style.WIDTH
    level = _names_fit(tracks, width)
    upright = not level and strip > 0.2
    for number, (phase, room) in enumerate(zip(tracks[0].phases, _rooms(tracks, width), strict=True)):
        if not level and not upright:
            text = str(number + 1)
            if room < PHASE_LETTER * (len(text) + 0.5):
                continue
        else:
            text = style.literal(phase.name)
            if upright and room < 0.09:
                continue
        axes.annotate(
            text,
            ((phase.start + phase.end) / 2, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 1.5),
            textcoords="offset points",
            fontsize=PHASE_FONT,
            color=style.GREY,
            ha="center",
            va="bottom",
            rotation=90 if upright else 0,
            annotation_clip=False,
        )
