"""Joint axes for plots, the rows of v after the base: names, coordinates, limits and their use, limbs."""

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, UNLIMITED, base_of, position_limits
from trajopt.motion.solution import Solution
from trajopt.view.plotting.motion import PlottedMotion

# Curves in one panel: the number of distinguishable colours.
MOST_CURVES = 7
# A branch of fewer joints (fingers, a head) shares the panel of other such branches.
LEAST_BRANCH = 3
KINDS = ("position", "velocity", "torque")
BEYOND = "beyond the axis"
# A limit this many times the values, such as a placeholder of 1000 rad/s, is not drawn to scale.
FAR = 20.0


@dataclass(frozen=True, kw_only=True)
class JointAxis:
    """A row of v after the base.

    Args:
        name: of the joint, with a suffix if the joint has several rows.
        joint: its number in the model.
        row: of v.
        torque: row of tau; None for a passive joint.
        column: of q; None if the coordinate is not an entry of q.
        slides: whether the row is a translation.
        lower, upper: limits of the position, rad or m; infinite if unlimited.
        speed, effort: limits, rad/s or m/s, and N m or N on the joint side; infinite if unlimited.
    """

    name: str
    joint: int
    row: int
    torque: int | None
    column: int | None
    slides: bool
    lower: float
    upper: float
    speed: float
    effort: float

    @property
    def unit(self) -> str:
        """Unit of the coordinate."""
        return "m" if self.slides else "rad"


@dataclass(frozen=True, kw_only=True)
class Limb:
    """A kinematic branch: its name, its axes, and their names.

    ``prefix`` is the common start of the axes' names, empty if it does not identify the limb. ``short`` names
    omit the common parts; ``long`` names distinguish the axes of all limbs.
    """

    name: str
    prefix: str
    axes: tuple[JointAxis, ...]
    short: tuple[str, ...]
    long: tuple[str, ...]

    @property
    def unit(self) -> str:
        """Unit of its coordinates; both if they are mixed."""
        return ", ".join(sorted({axis.unit for axis in self.axes}, reverse=True))


def axes_of(solution: Solution) -> tuple[JointAxis, ...]:
    """All rows of v after the base joint, in order."""
    model, description = solution.model, solution.description
    lower, upper = position_limits(model)
    speed = _limits(description.velocity_limit, model.nv)
    effort = _limits(description.effort_limit, solution.tau.shape[1])
    axes = []
    for joint in list(model.joints)[BASE_JOINT[base_of(model)] + 1 :]:
        for i in range(joint.nv):
            row = joint.idx_v + i
            torque = int(np.searchsorted(solution.actuated_rows, row))
            driven = row in solution.actuated_rows
            column = joint.idx_q + i if joint.nq == joint.nv else None
            suffix = "" if joint.nv == 1 else f" {'xyz'[i] if joint.nv <= 3 else i + 1}"
            axes.append(
                JointAxis(
                    name=model.names[joint.id] + suffix,
                    joint=joint.id,
                    row=row,
                    torque=torque if driven else None,
                    column=column,
                    slides=_slides(joint, i),
                    lower=-np.inf if column is None else float(lower[column]),
                    upper=np.inf if column is None else float(upper[column]),
                    speed=float(speed[row]),
                    effort=float(effort[torque]) if driven else np.inf,
                )
            )
    return tuple(axes)


def _limits(given: np.ndarray | None, size: int) -> np.ndarray:
    return np.full(size, np.inf) if given is None else np.where(given > UNLIMITED, np.inf, given)


def _slides(joint: pin.JointModel, row: int) -> bool:
    """Whether a row of a joint is a translation."""
    kind = joint.shortname().removeprefix("JointModel")
    translations = {"PX": 1, "PY": 1, "PZ": 1, "PrismaticUnaligned": 1, "Planar": 2, "Translation": 3}
    return row < (translations | {"FreeFlyer": 3}).get(kind, 0)


def position(axis: JointAxis, motion: PlottedMotion) -> np.ndarray:
    """Coordinate (K,) of an axis: rad or m, unwrapped; for a ball joint its rotation vector."""
    solution, model = motion.solution, motion.solution.model
    if axis.column is not None:
        return solution.q[:, axis.column]
    joint = model.joints[axis.joint]
    q, inner = solution.q[:, joint.idx_q : joint.idx_q + joint.nq], axis.row - joint.idx_v
    if joint.nq == 2 and joint.nv == 1:
        return _unwrapped(np.arctan2(q[:, 1], q[:, 0]))
    if joint.shortname() == "JointModelPlanar":
        return q[:, inner] if inner < 2 else _unwrapped(np.arctan2(q[:, 3], q[:, 2]))
    if joint.shortname() == "JointModelFreeFlyer" and inner < 3:
        return q[:, inner]
    turned = np.full((len(q), 3), np.nan)
    for row in np.flatnonzero(np.isfinite(q).all(axis=1)):
        turned[row] = pin.log3(pin.Quaternion(np.array(q[row, -4:])).toRotationMatrix())
    return turned[:, inner % 3]


def _unwrapped(angle: np.ndarray) -> np.ndarray:
    turned, finite = angle.copy(), np.isfinite(angle)
    turned[finite] = np.unwrap(angle[finite])
    return turned


def limbs_of(axes: Sequence[JointAxis], model: pin.Model) -> tuple[Limb, ...]:
    """Group axes by kinematic branch: chains between forks of the tree, of at most `MOST_CURVES` axes.

    Neighbouring short branches share a limb. Names are common prefixes of joint names.
    """
    groups: list[list[JointAxis]] = []
    for chain in _merged(_chains(model, {axis.joint for axis in axes})):
        members = [axis for joint in chain for axis in axes if axis.joint == joint]
        parts = -(-len(members) // MOST_CURVES)
        size = -(-len(members) // max(parts, 1))
        groups += [members[start : start + size] for start in range(0, len(members), size)]
    prefixes = [_limb_name([axis.name for axis in group]) for group in groups]
    shorts = [_short_names([axis.name for axis in group]) for group in groups]
    every = [short for names in shorts for short in names]
    unique = len(set(every)) == len(every)
    limbs = []
    for group, prefix, short in zip(groups, prefixes, shorts, strict=True):
        alone = len(group) == 1
        named = bool(prefix) and prefixes.count(prefix) == 1 and not alone
        limbs.append(
            Limb(
                name=prefix if named or alone else f"{group[0].name} to {group[-1].name}",
                prefix=prefix if named else "",
                axes=tuple(group),
                short=short,
                long=tuple(
                    f"{prefix} {name}" if named else name if unique else axis.name
                    for axis, name in zip(group, short, strict=True)
                ),
            )
        )
    return tuple(limbs)


def _chains(model: pin.Model, joints: set[int]) -> list[list[int]]:
    """Joints of the given set in chains that end at a leaf or a fork of the tree."""
    roots = [joint for joint in sorted(joints) if model.parents[joint] not in joints]
    chains, waiting = [], roots[::-1]
    while waiting:
        chain = [waiting.pop()]
        while len(children := list(model.children[chain[-1]])) == 1:
            chain += children
        chains.append(chain)
        waiting += children[::-1]
    return chains


def _merged(chains: list[list[int]]) -> list[list[int]]:
    """Merge neighbouring chains shorter than `LEAST_BRANCH`, as far as they fit one panel."""
    merged: list[list[int]] = []
    open_for_more = False
    for chain in chains:
        short = len(chain) < LEAST_BRANCH
        if short and open_for_more and len(merged[-1]) + len(chain) <= MOST_CURVES:
            merged[-1] = merged[-1] + chain
        else:
            merged.append(chain)
        open_for_more = short
    return merged


def _limb_name(names: Sequence[str]) -> str:
    """Common prefix of names up to a separator or a digit; may be empty."""
    common = _common_start(names)
    if len(names) == 1:
        return names[0]
    cut = max((match.end() for match in re.finditer(r"[_\W]", common)), default=0)
    if len(common) > cut and all(name[len(common) : len(common) + 1].isdigit() for name in names):
        cut = len(common)
    return common[:cut].rstrip("_. -")


def _common_start(names: Sequence[str]) -> str:
    """The longest common prefix of names."""
    same = itertools.takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    return "".join(letters[0] for letters in same)


def _short_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names without common words at the start or end."""
    if len(names) == 1:
        return tuple(names)
    before = _limb_name(names)
    cut = len(before)
    ends = _common_start([name[::-1] for name in names])[::-1]
    at = ends.find("_")
    behind = len(ends) - at if at >= 0 else 0
    bare = [name[: len(name) - behind] for name in names]
    bare = [name[cut:].strip("_. -") or name for name in bare]
    return tuple(bare) if all(bare) and len(set(bare)) == len(bare) else tuple(names)


def share(kind: str, axis: JointAxis, motion: PlottedMotion) -> np.ndarray:
    """Share (K,) of the limit that an axis uses; NaN where it has none.

    For a position, its distance from the middle of its range over half the range; for velocities and torques,
    the magnitude over the limit.
    """
    lower, upper = limit_of(kind, axis)
    half = (upper - lower) / 2
    if not (np.isfinite(half) and half > 0):
        return np.full(len(motion.t), np.nan)
    return np.abs(value(kind, axis, motion) - (upper + lower) / 2) / half


def value(kind: str, axis: JointAxis, motion: PlottedMotion) -> np.ndarray:
    """Position, velocity or torque (K,) of an axis."""
    if kind == "position":
        return position(axis, motion)
    if kind == "velocity":
        return motion.solution.v[:, axis.row]
    if axis.torque is None:
        return np.full(len(motion.t), np.nan)
    return motion.solution.tau[:, axis.torque]


def limit_of(kind: str, axis: JointAxis) -> tuple[float, float]:
    """Least and largest allowed value of an axis."""
    if kind == "position":
        return axis.lower, axis.upper
    most = axis.speed if kind == "velocity" else axis.effort
    return -most, most


def unit_of(kind: str, axis: JointAxis) -> str:
    """Unit of a position, velocity or torque of an axis."""
    if kind == "torque":
        return "N" if axis.slides else "N m"
    return axis.unit if kind == "position" else f"{axis.unit}/s"


def units_of(kind: str, axes: Sequence[JointAxis]) -> str:
    """Units of several axes, those of revolute ones first."""
    ordered = sorted(axes, key=lambda axis: axis.slides)
    return ", ".join(dict.fromkeys(unit_of(kind, axis) for axis in ordered))


def are_far(kind: str, axes: Sequence[JointAxis], motion: PlottedMotion) -> bool:
    """Whether all limits of velocity or torque are more than `FAR` times the values of the motion.

    Placeholders in a description are such limits. False for positions, without limits, and for values that
    are all zero.
    """
    used = np.array([share(kind, axis, motion) for axis in axes])
    return kind != "position" and bool(0.0 < used[np.isfinite(used)].max(initial=0.0) < 1 / FAR)


def most_used(kind: str, axes: Sequence[JointAxis], motion: PlottedMotion) -> float:
    """Return the largest magnitude of a velocity or torque; 0 if none is finite."""
    values = np.array([value(kind, axis, motion) for axis in axes])
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def limit_words(kind: str, axes: Sequence[JointAxis]) -> str:
    """Return limits of velocity or torque, as "limit 1000 rad/s" or "limits 24 to 45 N m"; empty if none."""
    parts = []
    for unit in dict.fromkeys(unit_of(kind, axis) for axis in axes):
        limits = [limit_of(kind, axis)[1] for axis in axes if unit_of(kind, axis) == unit]
        finite = sorted(limit for limit in limits if np.isfinite(limit))
        if finite:
            ends = dict.fromkeys(f"{limit:.4g}" for limit in (finite[0], finite[-1]))
            parts.append(f"{' to '.join(ends)} {unit}")
    several = len(parts) > 1 or any(" to " in part for part in parts)
    return f"limit{'s' * several} {', '.join(parts)}" if parts else ""
