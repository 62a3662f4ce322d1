"""The summary: one page with the essentials of each topic, and the list of all pages."""

from collections.abc import Callable, Sequence

from trajopt.errors import InputError, not_among
from trajopt.view.plotting import topics_accuracy as accuracy
from trajopt.view.plotting import topics_base as base
from trajopt.view.plotting import topics_contacts as contacts
from trajopt.view.plotting import topics_joints as joints
from trajopt.view.plotting import topics_limits as limits
from trajopt.view.plotting.draw import PlotPage, PlotRow, Tracks, page_of
from trajopt.view.plotting.topics_contacts import sole_pages

# Most rows of a map of shares in the summary: with more joints, one row per limb.
MAP_ROWS = 12
# Most limbs whose curves the summary of an arm shows.
FEW_LIMBS = 2


def summary_pages(tracks: Tracks) -> list[PlotPage]:
    """Contacts, shares of limits, base or joints, forces, momentum or power, errors: one page."""
    shares = _shares(tracks)
    is_map = shares is not None and len(tracks) == 1
    rows: list[PlotRow | None] = [contacts.stance_row(tracks), shares]
    moving = base.has_base(tracks)
    if moving:
        rows += [joints.torque_row(tracks), base.thrust_row(tracks)]
        rows += [base.vector_row(tracks, name) for name in ("base position", "base orientation")]
    else:
        limbs = joints.limbs(tracks)
        alone = len(limbs) == 1
        for limb in limbs[:FEW_LIMBS]:
            rows += joints.limb_rows(tracks, limb, wide=alone, alone=alone)
    if contacts.contacts(tracks):
        rows += [contacts.normal_row(tracks), contacts.cone_row(tracks)]
    if moving:
        rows.append(base.vector_row(tracks, "angular momentum"))
    rows += [base.clearance_row(tracks), base.power_row(tracks), accuracy.residual_row(tracks)]
    maps = "Maps: share of the limit that is used, on the right its largest in per cent; orange: beyond it. "
    note = f"{maps if is_map else ''}Residuals in natural units (weight, reach, g)."
    return page_of("summary", "summary", rows, note=note)


def _shares(tracks: Tracks) -> PlotRow | None:
    """One solution's map of shares of limits; of several the largest share of each as a curve."""
    rows, names = limits.axes_and_names(tracks)
    if not rows or len(tracks) > 1:
        return limits.largest_row(tracks) if rows else None
    groups = [[axis] for axis in rows]
    if len(rows) > MAP_ROWS:
        limbs = joints.limbs(tracks)
        groups, names = [list(limb.axes) for limb in limbs], [limb.name for limb in limbs]
    return limits.map_row(tracks, 0, groups, names)


PAGES: dict[str, Callable[[Tracks], list[PlotPage]]] = {
    "summary": summary_pages,
    "limits": limits.limit_pages,
    "joints": joints.joint_pages,
    "drives": joints.drive_pages,
    "forces": contacts.force_pages,
    "soles": sole_pages,
    "base": base.base_pages,
    "momentum": base.momentum_pages,
    "clearance": base.clearance_pages,
    "accuracy": accuracy.accuracy_pages,
}


def pages_of(tracks: Tracks, names: Sequence[str]) -> list[PlotPage]:
    """Pages by name, in this order; those that do not apply to the robot are left out.

    Raises `InputError` for an unknown name, or if none is left.
    """
    for name in names:
        if name not in PAGES:
            raise not_among(PAGES, name, f"page '{name}' is unknown")
    chosen = [page for name in names for page in PAGES[name](tracks)]
    if not chosen:
        have = [name for name, pages in PAGES.items() if pages(tracks)]
        raise InputError(
            f"the solution has nothing for page {', '.join(names)}", f"allowed: {', '.join(have)}"
        )
    return chosen
