"""Measured contacts: which transmit forces at a tick, which are late, and what each may transmit."""

from __future__ import annotations

import copy

import numpy as np

from trajopt.control.contact_forces import ActiveContact
from trajopt.control.plan_targets import PlanTargets
from trajopt.control.reference import ReferenceTrajectory

# A contact that is early by less than this fraction of its swing takes load at once.
EARLY = 1 / 3
# Time over sqrt(l / g) for which a lost contact still counts as standing: soft contacts chatter.
LOST = 0.05
# Speed at which a late foot is pressed down, over sqrt(g l), and its largest depth, over l.
PRESSED, DEEPEST = 0.1, 0.1


class MeasuredContacts:
    """Contacts of a plan, switched by which contacts touch.

    Args:
        reference: the tracked plan at the ticks.
        targets: its targets.
    """

    def __init__(self, reference: ReferenceTrajectory, targets: PlanTargets) -> None:
        self.frames, self._reference, self._targets = reference.contact_ids, reference, targets
        about, self._lost = reference.description, LOST * reference.units.time
        self._soles, self._rolling = about.soles.tolist(), about.rolling.tolist()
        self._sizes = [contact.half_size for contact in about.contacts]
        self._touched_at = np.full(len(self.frames), -np.inf)

    def copy(self) -> MeasuredContacts:
        """An independent copy of the contacts."""
        return copy.copy(self)  # times are replaced, not written

    def active(self, k: int, touching: np.ndarray) -> np.ndarray:
        """Contacts (nc,) that transmit forces: planned and touching, or early; held contacts as planned."""
        planned, targets = self._reference.active[k], self._targets
        now = k * self._reference.period
        self._touched_at = np.where(touching, now, self._touched_at)
        lately = now - self._touched_at <= self._lost
        swing = targets.next_stance[k] + targets.last_stance[k]
        early = touching & ~planned & (targets.next_stance[k] <= EARLY * swing)
        early &= targets.next_stance[k] < len(self._reference.t)
        held = planned & targets.surfaces.bilateral[k]
        started = planned & (k == 0)
        return np.asarray((planned & lately) | early | held | started)

    def late(self, i: int, k: int) -> float | None:
        """Time for which contact ``i`` has been due without touching, s; None if it should not stand."""
        planned = self._reference.active
        if not planned[k, i]:
            return None
        before = np.flatnonzero(~planned[:k, i])
        start = (before[-1] + 1) * self._reference.period if len(before) else 0.0
        return float(k * self._reference.period - max(self._touched_at[i], start))

    def of(self, i: int, k: int) -> ActiveContact:
        """Contact ``i`` on its planned surface."""
        surfaces, size = self._targets.surfaces, self._sizes[i]
        sliding = None
        normal = surfaces.normal[k, i]
        if surfaces.slides[k, i]:
            velocity = self._targets.velocity[k, i, :3]
            along = velocity - normal * (normal @ velocity)
            speed = float(np.linalg.norm(along))
            sliding = along / speed if speed > 0 else None
        return ActiveContact(
            number=i,
            frame=self.frames[i],
            dimension=6 if self._soles[i] else 3,
            normal=normal,
            friction=float(surfaces.friction[k, i]),
            half_size=(0.0, 0.0) if not size else (float(size[0]), float(size[1])),
            bilateral=bool(surfaces.bilateral[k, i]),
            sliding=sliding,
            lever=surfaces.lever[k, i] if self._rolling[i] else None,
        )
