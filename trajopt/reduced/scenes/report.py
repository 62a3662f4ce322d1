"""Report of a scene: each modelling decision, whether it is exact or a choice, and what it saves."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trajopt.problem.problem import Problem
from trajopt.reduced.term_reader import TermReader
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.friction import ContactConstraint
from trajopt.terms.limits import PositionLimits, TorqueLimits, VelocityLimits
from trajopt.terms.swing import SwingClearance
from trajopt.transcription.mesh import Mesh

EXACT, CHOICE, KEPT, OFFER = "exact", "choice", "kept", "offer"
_Remark = tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class ProblemSize:
    """Number of variables and rows of a transcription."""

    variables: int
    rows: int


@dataclass(frozen=True, kw_only=True)
class Decision:
    """One decision about what a scene models.

    Args:
        kind: "exact", the optimum is unchanged; "choice", it may change, by an amount to be measured; "kept",
            needed and modelled; "offer", could be left out on request.
        what: What was left out, kept or offered.
        why: The reason.
        saved: Variables and rows saved; 0 where the problem as built had none.
    """

    kind: str
    what: str
    why: str
    saved: ProblemSize = ProblemSize(variables=0, rows=0)


@dataclass(frozen=True, kw_only=True)
class SceneReport:
    """All decisions of a scene, and the sizes before and after on the given mesh."""

    problem: str
    robot: str
    modelled: tuple[str, ...]
    decisions: tuple[Decision, ...]
    before: ProblemSize
    after: ProblemSize
    transcription: str
    intervals: int

    @property
    def is_exact(self) -> bool:
        """Whether the reduced problem has the same optimum, that is, whether no decision was a choice."""
        return not any(decision.kind == CHOICE for decision in self.decisions)

    def of_kind(self, kind: str) -> tuple[Decision, ...]:
        """Return the decisions of one kind."""
        return tuple(decision for decision in self.decisions if decision.kind == kind)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON-able entries."""
        return {**asdict(self), "exact": self.is_exact}

    def __str__(self) -> str:
        lines = [f"{self.problem} on {self.robot}: {self.transcription}, {self.intervals} intervals"]
        lines += [f"  {'' if i else 'modelled':10} {line}" for i, line in enumerate(self.modelled)]
        for kind, title in ((EXACT, "left out, exactly"), (CHOICE, "left out, a choice"), (OFFER, "offered")):
            for decision in self.of_kind(kind):
                less = decision.saved
                saving = f" (-{less.variables} variables, -{less.rows} rows)"
                if not (less.variables or less.rows):
                    saving = ""
                lines += [f"  {title}: {decision.what}{saving}", f"      {decision.why}"]
        for decision in self.of_kind(KEPT):
            lines += [f"  kept: {decision.what}", f"      {decision.why}"]
        variables, rows = str(self.after.variables), str(self.after.rows)
        if self.before != self.after:
            variables, rows = f"{self.before.variables} -> {variables}", f"{self.before.rows} -> {rows}"
        return "\n".join([*lines, f"  size       {variables} variables, {rows} rows"])


def modelled(problem: Problem, whole: Problem, needs: Mapping[str, str]) -> tuple[str, ...]:
    """Describe what is modelled: base, joints and why they are needed, contacts of each phase, inputs."""
    robot = problem.robot
    lines = [f"{robot.base} base, {robot.n_unactuated} rows without actuator, {robot.nu} joints with one"]
    by_reason: dict[str, list[str]] = {}
    joints = set(robot.model.names)
    for name, reason in needs.items():
        if name in joints and whole.robot.model.joints[whole.robot.model.getJointId(name)].nv == 1:
            by_reason.setdefault(reason, []).append(name)
    lines += [f"{', '.join(names)}: {reason}" for reason, names in by_reason.items()]
    for phase in problem.schedule.phases:
        sizes = [f"{name} ({robot.contact(name).dimension})" for name in phase.contacts]
        lines.append(f"phase '{phase.name}': " + (f"forces of {', '.join(sizes)}" if sizes else "no forces"))
    lines.append(f"inputs: {problem.actuation}")
    return tuple(lines)


def remarks(problem: Problem, whole: Problem, mesh: Mesh) -> Iterator[Decision]:
    """Yield the rows and variables that are never built, and those that could be left out on request.

    Counts are for ``mesh``.
    """
    points = [phase.count * phase.method.s for phase in mesh.phases]
    for what, why in _never_modelled(problem, whole, points):
        yield Decision(kind=EXACT, what=what, why=why)
    for what, why in (*_offered_points(problem, points), *_offered_velocity(problem)):
        yield Decision(kind=OFFER, what=what, why=why)


def _never_modelled(problem: Problem, whole: Problem, points: list[int]) -> Iterator[_Remark]:
    """Yield forces in the air, unreachable limits, friction of grasps, clearance of standing feet."""
    robot, phases = problem.robot, problem.schedule.phases
    count = sum(
        number * sum(c.dimension for c in robot.contacts if c.name not in phase.contacts)
        for number, phase in zip(points, phases, strict=True)
    )
    if count:
        yield (
            f"forces of contacts in the air, {count} variables and their complementarity rows",
            "the schedule says who is in contact: a contact that is not has neither force nor row",
        )
    for term in problem.terms:
        if isinstance(term, TorqueLimits | VelocityLimits | PositionLimits):
            beyond, why = int(np.sum(term.left_out(robot))), _threshold(term, robot)
            if beyond:
                yield f"rows of {beyond} {term.name.replace('_', ' ')}", f"{why}; the check verifies them"
    held = [
        f"'{name}' in '{phase.name}'"
        for phase in whole.schedule.phases
        for name in phase.contacts
        if phase.surface(name, whole.terrain).bilateral
    ]
    if held and any(isinstance(term, ContactConstraint) for term in whole.terms):
        yield f"friction rows of {', '.join(held)}", "the surface holds the contact in every direction"
    always = [c.name for c in robot.contacts if all(c.name in phase.contacts for phase in phases)]
    if always and any(isinstance(term, SwingClearance) for term in problem.terms):
        yield f"clearance rows of {', '.join(always)}", "always on the ground"


def _threshold(term: TorqueLimits | VelocityLimits | PositionLimits, robot: Robot) -> str:
    """Describe the threshold beyond which a term leaves limits out."""
    units = Units(robot)
    if isinstance(term, TorqueLimits):
        return f"beyond 30 m g l = {units.unreachable_torque:.3g} N m"
    if isinstance(term, VelocityLimits):
        return f"beyond 30 sqrt(g / l) = {units.unreachable_velocity:.3g} rad/s"
    return "more than a turn from the reference posture"


def _offered_points(problem: Problem, points: list[int]) -> Iterator[_Remark]:
    held = {n for phase in problem.schedule.phases for n, s in phase.surfaces.items() if s.bilateral}
    soles = [c for c in problem.robot.contacts if c.kind == "surface" and c.name not in held]
    fewer = sum(
        number * sum(sum(row >= 3 for row in c.rows) for c in soles if c.name in phase.contacts)
        for number, phase in zip(points, problem.schedule.phases, strict=True)
    )
    if fewer and len(soles) > 1:
        yield (
            f"soles {', '.join(c.name for c in soles)} as points: {fewer} fewer variables",
            "only where a sole's moment does not matter, with two or more soles apart: a sole may tilt",
        )


def _offered_velocity(problem: Problem) -> Iterator[_Remark]:
    """Offer velocity inputs if no term uses accelerations, or rates at nodes."""
    if problem.actuation != "acceleration" or problem.robot.n_unactuated or problem.initial_v.any():
        return
    if any(phase.contacts for phase in problem.schedule.phases):
        return
    for instance in TermReader(problem).every():
        context = instance.context
        if instance.uses(context.ddxi if instance.node is None else context.rates):
            return
    yield (
        "accelerations, with velocities as inputs",
        "replace(problem, actuation='velocity'): configurations are the state, and rates may jump",
    )
