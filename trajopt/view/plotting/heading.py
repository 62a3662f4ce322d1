"""The head and the foot of a page: what was solved, how that ended, which line is which solution."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajopt.view.plotting import style
from trajopt.view.plotting.page import BOTTOM, LEFT, NOTE_LINE, RIGHT, TITLE, TOP, PlotPage, Tracks
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Letters that the width of a page has room for: in the title beside the page's name, and in the legend.
TITLE_LETTERS, LEGEND_LETTERS = 64, 112


def draw_heading(figure: Figure, page: PlotPage, tracks: Tracks, footer: str) -> None:
    """Write title, state of the solutions, note and footer."""
    width, height = figure.get_size_inches()

    def text(x: float, y: float, words: str, **options: object) -> None:
        look = {"va": "top", **options}
        figure.text(x / width, 1 - y / height, style.literal(words), **look)  # type: ignore[arg-type]

    text(LEFT, TOP, style.short(title_of(tracks), TITLE_LETTERS), fontsize=style.TITLE, weight="bold")
    text(width - RIGHT, TOP + 0.02, page.title, fontsize=style.TITLE, ha="right", color=style.GREY)
    warning = failures_of(tracks)
    below = TOP + 0.24
    if warning:
        text(LEFT, below, warning, fontsize=style.FONT, weight="bold", color=style.RED)
    elif len(tracks) == 1:
        text(LEFT, below, state_of(tracks[0]), fontsize=style.SMALL, color=style.GREY)
    if len(tracks) > 1:
        _solutions(figure, tracks, TOP + TITLE - 0.08)
    lines = page.note_lines
    for number, line in enumerate(lines):
        below = height - BOTTOM + 0.12 - NOTE_LINE * (len(lines) - number)
        text(LEFT, below, line, fontsize=6.5, color=style.GREY)
    text(LEFT, height - 0.26, footer, fontsize=6.5, color=style.GREY)


def _solutions(figure: Figure, tracks: Tracks, at: float) -> None:
    """The line style of every solution."""
    from matplotlib.lines import Line2D

    width, height = figure.get_size_inches()
    handles = [
        Line2D([], [], color=style.BLACK, linestyle=style.line_style(number)) for number in range(len(tracks))
    ]
    letters = LEGEND_LETTERS // len(tracks)
    names = [
        style.literal(style.short(track.label, letters)) + ("" if track.meta["success"] else " (not solved)")
        for track in tracks
    ]
    figure.legend(
        handles,
        names,
        loc="upper left",
        bbox_to_anchor=(LEFT / width, 1 - at / height),
        ncols=len(tracks),
        handlelength=3.2,
        columnspacing=1.5,
    )


def title_of(tracks: Tracks) -> str:
    """Return problem and robot; of several problems their names."""
    names = list(dict.fromkeys(str(track.meta["problem"]) for track in tracks))
    return f"{', '.join(names)} on {tracks[0].meta['robot']}"


def state_of(track: Track) -> str:
    """Describe a solution in a line: how it ended, by what, on which grid."""
    meta, plan = track.meta, track.solution
    objective = meta.get("objective")
    parts = [
        "solved" if meta["success"] else f"not solved, {str(meta['status']).replace('_', ' ')}",
        f"{meta['solver']}, {meta['iterations']} iterations",
        f"objective {objective:.6g}" if isinstance(objective, float) else "",
        f"{meta['transcription']}, {plan.n_intervals} interval{'s' * (plan.n_intervals > 1)}",
        f"{plan.t[-1] - plan.t[0]:.3g} s",
    ]
    return "  \u00b7  ".join(part for part in parts if part)


def failures_of(tracks: Tracks) -> str:
    """Say which solutions failed; empty if none did."""
    found = []
    for track in tracks:
        name = f"{track.label}: " if len(tracks) > 1 else ""
        if not track.meta["success"] and not track.is_simulated:
            found.append(
                f"{name}NOT SOLVED ({str(track.meta['status']).replace('_', ' ')}): the last iterate"
            )
        if not track.is_finite:
            found.append(f"{name}NOT FINITE: what is finite is shown")
    return "; ".join(found)
