"""The pipeline from a problem to the smallest one with the same task.

Decisions are taken in this order, each on the result of the previous one:

- drop costs of weight zero; merge four corner points of a foot into one sole (`soles`);
- drop contacts that are never active, lock joints that nothing needs;
- halve a symmetric robot on a symmetric task (`plane`, `half`);
- lock the joints that leave the plane, in limbs that move in it without them (`plane`);
- drop torques if no term uses them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_COORDINATES
from trajopt.dynamics.rerooting import joints_with
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.plane import halve_robot, in_plane
from trajopt.reduced.scenes.reduction import Reduction, behind_base, lift_solution, lock_joints
from trajopt.reduced.scenes.report import (
    CHOICE,
    EXACT,
    KEPT,
    Decision,
    ProblemSize,
    SceneReport,
    modelled,
    remarks,
)
from trajopt.reduced.scenes.soles import Soles, with_soles
from trajopt.reduced.scenes.terms import reduced_problem
from trajopt.reduced.term_reader import TermInstance, TermReader
from trajopt.robot.robot import Robot
from trajopt.terms.context_symbols import Place
from trajopt.terms.costs import (
    AccelerationCost,
    ImpulseCost,
    PostureCost,
    TimeCost,
    TorqueCost,
    VelocityCost,
    WrenchCost,
)
from trajopt.terms.drives import DriveLimits, MotorTorqueCost
from trajopt.terms.interfaces import Cost
from trajopt.terms.limits import PositionLimits, TorqueLimits, VelocityLimits
from trajopt.terms.swing import SwingClearance
from trajopt.terms.terminal import TerminalRest, TerminalState
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.transcription import chosen_mesh, transcribe

# Costs and limits that a joint at rest at its start satisfies.
NO_NEED = (
    TorqueCost, AccelerationCost, VelocityCost, WrenchCost, TimeCost, ImpulseCost, MotorTorqueCost,
    TorqueLimits, VelocityLimits, PositionLimits, DriveLimits, TerminalRest,
)  # fmt: skip
# A joint whose goal is within this distance of its start, rad or m, may stay: postures in files are rounded.
SAME_PLACE = 1e-9

Needs = dict[str, str]
KEPT_AS_ASKED = "kept as asked"
Plane = Literal["auto", True, False]


def needed_joints(problem: Problem, keep: Sequence[str]) -> Needs:
    """Return the joints that must move, by name, each with the first reason found.

    These are: joints of the base, passive joints, joints that start with a velocity, joints that carry an
    active contact or a frame used by a term, joints whose goal differs from their start, joints in ``keep``,
    and joints whose coordinates are used by a term of unknown kind; mimic joints and their leaders come
    together. Raises `InputError` for an unknown name in ``keep``.
    """
    robot, needs = problem.robot, _unconditional_needs(problem)
    _require_known(robot, keep, "keep")
    for phase in problem.schedule.phases:
        for contact in phase.contacts:
            _chain(robot, robot.contact(contact).frame, f"carries contact '{contact}'", needs)
    for instance in TermReader(problem).every():
        for frame in instance.frames:
            _chain(robot, frame, f"moves frame '{frame}' of {instance.term.name}", needs)
        for name in _direct_joints(problem, instance):
            needs.setdefault(name, f"is in {instance.term.name}")
    for term in problem.terms:
        if isinstance(term, PostureCost | TerminalState):  # does the target differ from the start?
            target = robot.reference if term.q is None else np.asarray(term.q, dtype=float)
            apart = np.abs(target - problem.initial_q)
            apart[: BASE_COORDINATES[robot.base]] = 0.0
            for name in joints_with(robot.model, apart > SAME_PLACE):
                needs.setdefault(name, f"{term.name} wants it elsewhere")
    for name in keep:
        needs.setdefault(name, KEPT_AS_ASKED)
    for mimic in robot.mimics:
        if mimic.joint in needs or mimic.mimics in needs:
            needs.setdefault(mimic.joint, f"follows '{mimic.mimics}'")
            needs.setdefault(mimic.mimics, f"leads '{mimic.joint}'")
    return needs


def cleared_contacts(problem: Problem) -> set[str]:
    """Return the contacts that a clearance term keeps off the ground in some phase."""
    frames = {
        frame
        for instance in TermReader(problem).every()
        if isinstance(instance.term, SwingClearance)
        for frame in instance.frames
    }
    return {contact.name for contact in problem.robot.contacts if contact.frame in frames}


def require_lockable(problem: Problem, lock: Sequence[str], keep: Sequence[str]) -> None:
    """Raise `InputError` for joints to lock that are unknown, kept, passive, moving, or part of the base."""
    _require_known(problem.robot, lock, "lock")
    for name in lock:
        reason = "is kept as well" if name in keep else _unconditional_needs(problem).get(name)
        if reason:
            raise InputError(f"joint '{name}' to lock {reason}", "another joint")


def _require_known(robot: Robot, names: Sequence[str], purpose: str) -> None:
    known = list(robot.model.names)[1:]
    for name in names:
        if name not in known:
            raise InputError(f"joint '{name}' to {purpose} is unknown", "one of " + ", ".join(known))


def _unconditional_needs(problem: Problem) -> Needs:
    robot, needs = problem.robot, {}
    followers = {mimic.joint for mimic in robot.mimics}
    for joint in list(robot.model.joints)[1:]:
        name = robot.model.names[joint.id]
        if joint.idx_v in robot.unactuated_rows and name not in followers:
            needs[name] = "has no actuator" if name in robot.passive else "is the base"
        elif problem.initial_v[joint.idx_v : joint.idx_v + joint.nv].any():
            needs[name] = "starts moving"
    return needs


def _chain(robot: Robot, frame: str, reason: str, needs: Needs) -> None:
    model = robot.model
    for joint in model.supports[model.frames[model.getFrameId(frame)].parentJoint]:
        if joint > 0:
            needs.setdefault(model.names[joint], reason)


def _direct_joints(problem: Problem, instance: TermInstance) -> list[str]:
    """Return the joints whose coordinates are used directly by a term of unknown kind."""
    if (
        isinstance(instance.term, (*NO_NEED, PostureCost, TerminalState))
        or instance.context.place is Place.IMPACT
    ):
        return []
    return joints_with(problem.robot.model, instance.rates())


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallestScene:
    """A task and the smallest problem found for it.

    Args:
        original: The problem as built.
        problem: The reduced problem, ready for `trajopt.solve`.
        reduction: The map from the whole robot to the robot of ``problem``.
        steps: Every decision, with the problem that results from it, or None if it changed nothing.
        modelled: Lines of the report about what remains.
        mesh: The mesh for which sizes are reported.
        soles: The surface contacts that replaced corner points, or None.
    """

    original: Problem
    problem: Problem
    reduction: Reduction
    steps: tuple[tuple[Decision, Problem | None], ...]
    modelled: tuple[str, ...]
    mesh: Mesh
    soles: Soles | None = None

    @cached_property
    def report(self) -> SceneReport:
        """Every decision with its reason and savings; transcribes each intermediate problem."""
        size = before = size_of(self.original, self.mesh)
        decisions = []
        for decision, made in self.steps:
            after = size if made is None else size_of(made, self.mesh)
            saved = ProblemSize(variables=size.variables - after.variables, rows=size.rows - after.rows)
            decisions.append(replace(decision, saved=saved))
            size = after
        return SceneReport(
            problem=self.original.name,
            robot=self.original.robot.name,
            modelled=self.modelled,
            decisions=tuple(decisions),
            before=before,
            after=size,
            transcription=self.mesh.transcription,
            intervals=sum(self.mesh.counts),
        )

    def lift(self, solution: Solution) -> Solution:
        """Return a solution of ``problem`` as one of the whole robot, for ``check`` and ``replay``.

        Torques, also those of locked joints, are recomputed by inverse dynamics of the whole robot.
        """
        whole = self.original if self.soles is None else self.soles.problem
        lifted = lift_solution(solution, whole, self.reduction)
        return lifted if self.soles is None else self.soles.lift(lifted, self.original)


@checked
def smallest(
    problem: Problem,
    *,
    keep: Sequence[str] = (),
    lock: Sequence[str] = (),
    plane: Plane = "auto",
    soles: bool = True,
    torques: bool = False,
    transcription: str | None = None,
    intervals: int | None = None,
    mesh: Mesh | None = None,
) -> SmallestScene:
    """Return the smallest problem with the same task as ``problem``, without solving anything.

    Args:
        problem: The problem of the whole robot.
        keep: Names of joints that are never locked.
        lock: Names of joints to lock even if something needs them.
        plane: Halve a symmetric robot on a symmetric task if possible ("auto"), always (True), never (False).
        soles: Merge four point contacts at the corners of a rectangle on one link into a surface contact.
        torques: Model torques even if no term uses them.
        transcription: Scheme for which sizes are reported; default: the problem's.
        intervals: Number of intervals for which sizes are reported; default: the problem's.
        mesh: Mesh for which sizes are reported, instead of the two above.

    Raises:
        InputError: If a joint is unknown or must not be locked, or if ``plane=True`` and the robot or the
            task is not symmetric; the message says what is not.
    """
    search = _Smallest(problem, tuple(keep), plane, chosen_mesh(problem, transcription, intervals, mesh))
    return search.build(tuple(lock), soles, torques)


@checked
def size_of(problem: Problem, mesh: Mesh) -> ProblemSize:
    """Return the number of variables and rows of a problem's transcription."""
    made = transcribe(problem, mesh=mesh)
    return ProblemSize(variables=made.layout.n_unknowns, rows=made.n_rows)


class _Smallest:
    def __init__(self, problem: Problem, keep: tuple[str, ...], plane: Plane, mesh: Mesh) -> None:
        self.original, self.keep, self.plane, self.mesh = problem, keep, plane, mesh
        self.whole = problem
        self.problem = problem
        self.steps: list[tuple[Decision, Problem | None]] = []
        self.reduction = lock_joints(problem.robot, (), problem.initial_q)

    def build(self, lock: tuple[str, ...], soles: bool, torques: bool) -> SmallestScene:
        self.drop_idle_costs()
        merged = self.merge_corners() if soles else None
        self.needs = needed_joints(self.whole, self.keep)
        require_lockable(self.whole, lock, self.keep)
        if self.refuses():
            self.note(KEPT, "the whole robot", self.refuses())
            if self.plane is True:
                raise InputError(f"problem '{self.original.name}' cannot be halved: {self.refuses()}")
        else:
            self.drop_contacts()
            self.lock(lock)
            self.halve()
        if not torques:
            self.drop_torques()
        self.steps += ((remark, None) for remark in remarks(self.problem, self.whole, self.mesh))
        return SmallestScene(
            original=self.original,
            problem=self.problem,
            reduction=self.reduction,
            steps=tuple(self.steps),
            modelled=modelled(self.problem, self.whole, self.needs),
            mesh=self.mesh,
            soles=merged,
        )

    def note(self, kind: str, what: str, why: str) -> None:
        """Record a decision and the current problem, without the problem for a decision to keep something."""
        made = None if kind == KEPT else self.problem
        self.steps.append((Decision(kind=kind, what=what, why=why), made))

    def refuses(self) -> str:
        """Return why the problem cannot be reduced, or an empty string."""
        if self.whole.dynamics is not None:
            return "the problem brings its own dynamics"
        if self.whole.periodicity is not None or self.whole.payloads or self.whole.wrenches:
            return "a periodic motion, a payload or a wrench is written for all joints"
        return "phases in minimal coordinates are written for all joints" if self.whole.modes else ""

    def drop_idle_costs(self) -> None:
        idle = [t for t in self.whole.terms if isinstance(t, Cost) and t.weight == 0]
        if idle:
            terms = tuple(t for t in self.whole.terms if t not in idle)
            self.whole = self.problem = replace(self.whole, terms=terms)
            self.note(EXACT, ", ".join(t.name for t in idle), "a cost of weight zero has no effect")

    def merge_corners(self) -> Soles | None:
        merged = with_soles(self.whole)
        if merged is not None:
            self.whole = self.problem = merged.problem
            self.reduction = lock_joints(self.whole.robot, (), self.whole.initial_q)
            corners = [f"{', '.join(sole.corners)} as sole '{sole.contact.name}'" for sole in merged.soles]
            what = f"12 rows of four corners as 6 of a sole: {'; '.join(corners)}"
            why = "coplanar points of one rigid link: 12 rows of rank 6; exact except for the friction model"
            self.note(CHOICE, what, why)
        return merged

    def reduce(self, reduction: Reduction) -> None:
        self.reduction = reduction
        self.problem = reduced_problem(self.whole, reduction)

    def drop_contacts(self) -> None:
        """Drop contacts that are active in no phase, unless a clearance term applies to them."""
        robot, phases = self.whole.robot, self.whole.schedule.phases
        needed = {name for phase in phases for name in phase.contacts} | cleared_contacts(self.whole)
        idle = [c.name for c in robot.contacts if c.name not in needed]
        if idle:
            self.reduce(lock_joints(robot, (), self.whole.initial_q, needed))
            self.note(EXACT, f"contacts {', '.join(idle)}", "active in no phase, and nothing must clear them")

    def lock(self, wanted: tuple[str, ...]) -> None:
        robot, contacts = self.whole.robot, list(self.reduction.contacts)
        idle = [name for name in behind_base(robot) if name not in self.needs]
        if wanted:
            self.reduce(lock_joints(robot, wanted, self.whole.initial_q, contacts))
            self.note(CHOICE, f"{len(wanted)} joints locked: {', '.join(wanted)}", "at their start, as asked")
        idle = [name for name in idle if name not in wanted]
        if len(idle) + len(wanted) == robot.model.njoints - 1:
            why = "no joint is needed, and a robot must have a joint"
            self.note(KEPT, "all other joints", why)
        elif idle:
            self.reduce(lock_joints(robot, [*wanted, *idle], self.whole.initial_q, contacts))
            why = (
                "at their start: no contact, goal, clearance or other target needs them; they shift no weight"
            )
            self.note(CHOICE, f"{len(idle)} joints locked: {', '.join(idle)}", why)
        asked = [name for name in self.keep if self.needs.get(name) == KEPT_AS_ASKED]
        if asked:
            self.note(KEPT, f"joints {', '.join(asked)}, as asked", "nothing else needs them")

    def halve(self) -> None:
        """Replace the robot by its half in the plane if robot and task are symmetric."""
        if self.plane is False or (self.plane == "auto" and self.whole.robot.base != "freeflyer"):
            return
        try:
            half, decision = halve_robot(self.problem, self._kept())
        except InputError as error:
            if self.plane is True:
                raise
            self.note(KEPT, "both sides", str(error))
            return
        self.reduce(self.reduction.then(half))
        self.note(decision.kind, decision.what, decision.why)
        to_lock, stay = in_plane(self.problem, self._kept())
        if to_lock:
            locked = lock_joints(self.problem.robot, to_lock, self.problem.initial_q)
            self.reduce(self.reduction.then(locked))
            what = f"{len(to_lock)} joints that leave the plane locked: {', '.join(to_lock)}"
            why = "the limbs' other joints move in planes without them, feet do not slide"
            self.note(CHOICE, what, f"at their start, in pairs: {why}")
        if stay:
            why = "their limbs' other joints leave it too, or a goal or the caller needs them"
            self.note(KEPT, "joints that leave the plane", f"{', '.join(stay)}: {why}")

    def _kept(self) -> tuple[str, ...]:
        """Return the current names of the joints to keep."""
        followers = self.reduction.joints
        return tuple(followers[name].name for name in self.keep if name in followers)

    def drop_torques(self) -> None:
        """Use accelerations as inputs if no term uses torques: the same problem with fewer rows."""
        instances = TermReader(self.problem).every()
        if self.problem.actuation == "torque" and not any(one.uses_torques for one in instances):
            self.problem = replace(self.problem, actuation="acceleration")
            self.note(EXACT, "joint torques", "no term limits, prices or uses them: accelerations are inputs")
