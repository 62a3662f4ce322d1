"""The pipeline from a problem to the smallest one with the same task.

Decisions are taken in this order, each on what the one before left:

- costs of weight zero; four corner points of a foot as one sole (`scene_soles`);
- contacts that are never active, joints that nothing needs (`scene_needs`, `scene_lock`);
- the mirrored half of a symmetric robot on a symmetric task (`scene_plane`, `scene_half`);
- joints that leave the plane, where the limb moves in it without them (`scene_flat`);
- torques, if no term asks for them (`scene_torque`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.facts import modelled, remarks
from trajopt.reduced.scenes.flat import flattened
from trajopt.reduced.scenes.lift import lifted
from trajopt.reduced.scenes.lock import behind_base, chained, locked
from trajopt.reduced.scenes.needs import KEPT_AS_ASKED, cleared_contacts, needed_joints, require_lockable
from trajopt.reduced.scenes.plane import Halved, halved
from trajopt.reduced.scenes.reduction import Reduction
from trajopt.reduced.scenes.report import CHOICE, EXACT, KEPT, Decision, SceneReport, Size
from trajopt.reduced.scenes.soles import Soles, with_soles
from trajopt.reduced.scenes.terms import reduced_problem
from trajopt.reduced.scenes.torque import without_torques
from trajopt.solution.solution import Solution
from trajopt.terms.interfaces import Cost
from trajopt.transcription.transcription import transcribe

Plane = Literal["auto", True, False]
NOTHING = Size(variables=0, rows=0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A task and the smallest problem found for it.

    original: the problem as built. problem: the reduced one, ready for ``trajopt.solve``. reduction: from the
    whole robot to the one of ``problem``. report: every decision with its reason and what it saved.
    """

    original: Problem
    problem: Problem
    reduction: Reduction
    report: SceneReport
    soles: Soles | None = None

    def lift(self, solution: Solution) -> Solution:
        """Return a solution of ``problem`` as one of the whole robot: what ``check`` and ``replay`` take.

        Its torques are those of the whole robot on this motion, locked joints' too, by inverse dynamics.
        """
        whole = self.original if self.soles is None else self.soles.problem
        found = lifted(solution, whole, self.reduction)
        return found if self.soles is None else self.soles.lift(found, self.original)


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
) -> Scene:
    """Return the smallest problem with the task of ``problem``.

    keep: joints, by name, that are never locked. lock: joints that are, whatever needs them. plane: halve a
    symmetric robot on a symmetric task if that is found possible ("auto"), must be (True), or never (False).
    soles: four coplanar point contacts at a
    rectangle's corners on one link become one surface contact. torques: model them although no term asks for
    them. transcription, intervals: the grid that sizes are reported for; default the problem's.

    Nothing is solved. Raises `InputError` for an unknown joint, and with ``plane=True`` where the robot or
    the task is not symmetric: the message says what is not.
    """
    if plane not in get_args(Plane) or (isinstance(plane, int) and not isinstance(plane, bool)):
        raise InputError(f"plane={plane!r} is unknown", "'auto', True or False")
    made = _Smallest(problem, tuple(keep), plane, (transcription, intervals))
    return made.build(tuple(lock), soles, torques)


def size_of(problem: Problem, transcription: str | None = None, intervals: int | None = None) -> Size:
    """Unknowns and rows of a problem's transcription."""
    made = transcribe(problem, transcription, intervals)
    return Size(variables=made.layout.n_unknowns, rows=made.n_rows)


class _Smallest:
    def __init__(
        self, problem: Problem, keep: tuple[str, ...], plane: Plane, grid: tuple[str | None, int | None]
    ) -> None:
        self.original, self.keep, self.plane, self.grid = problem, keep, plane, grid
        self.whole = problem
        self.problem = problem
        self.decisions: list[Decision] = []
        self.size = self.before = size_of(problem, *grid)
        names = [contact.name for contact in problem.robot.contacts]
        self.reduction = locked(problem.robot, (), names, problem.initial_q)

    def build(self, lock: tuple[str, ...], soles: bool, torques: bool) -> Scene:
        self.drop_idle_costs()
        merged = self.merge_corners() if soles else None
        self.needs = needed_joints(self.whole, self.keep)
        require_lockable(self.whole, lock, self.keep)
        if self.refuses():
            self.keep_whole()
        else:
            self.drop_contacts()
            self.lock(lock)
            self.halve()
        if not torques:
            self.drop_torques()
        self.decisions += remarks(self.problem, self.whole, self.grid)
        return Scene(
            original=self.original,
            problem=self.problem,
            reduction=self.reduction,
            report=self.report(),
            soles=merged,
        )

    def note(self, kind: str, what: str, why: str) -> None:
        """Record a decision with what it saved since the last."""
        size = size_of(self.problem, *self.grid)
        self.decisions.append(Decision(kind=kind, what=what, why=why, saved=self.size.less(size)))
        self.size = size

    def keep_whole(self) -> None:
        self.decisions.append(Decision(kind=KEPT, what="the whole robot", why=self.refuses()))
        if self.plane is True:
            raise InputError(f"problem '{self.original.name}' cannot be halved: {self.refuses()}")

    def refuses(self) -> str:
        """Why no robot but the whole one fits the problem, or an empty text."""
        if self.whole.dynamics is not None:
            return "the problem brings its own dynamics"
        if self.whole.periodicity is not None or self.whole.payloads:
            return "a periodic motion or a payload is written for all joints"
        return "phases in minimal coordinates are written for all joints" if self.whole.modes else ""

    def drop_idle_costs(self) -> None:
        idle = [t for t in self.whole.terms if isinstance(t, Cost) and t.weight == 0]
        if idle:
            terms = tuple(t for t in self.whole.terms if t not in idle)
            self.whole = self.problem = replace(self.whole, terms=terms)
            self.note(EXACT, ", ".join(t.name for t in idle), "a cost of weight zero asks for nothing")

    def merge_corners(self) -> Soles | None:
        merged = with_soles(self.whole)
        if merged is not None:
            self.whole = self.problem = merged.problem
            names = [contact.name for contact in self.whole.robot.contacts]
            self.reduction = locked(self.whole.robot, (), names, self.whole.initial_q)
            self.note(merged.kind, merged.what, merged.why)
        return merged

    def reduce(self, reduction: Reduction) -> None:
        self.reduction = reduction
        self.problem = reduced_problem(self.whole, reduction)

    def drop_contacts(self) -> None:
        """Contacts that no phase has, unless a swing must clear the ground with them."""
        robot, phases = self.whole.robot, self.whole.schedule.phases
        needed = {name for phase in phases for name in phase.contacts} | cleared_contacts(self.whole)
        idle = [c.name for c in robot.contacts if c.name not in needed]
        if idle:
            names = [c.name for c in robot.contacts if c.name in needed]
            self.reduce(locked(robot, (), names, self.whole.initial_q))
            self.note(EXACT, f"contacts {', '.join(idle)}", "active in no phase, and nothing must clear them")

    def lock(self, wanted: tuple[str, ...]) -> None:
        robot, contacts = self.whole.robot, list(self.reduction.contacts)
        idle = [name for name in behind_base(robot) if name not in self.needs]
        if wanted:
            self.reduce(locked(robot, wanted, contacts, self.whole.initial_q))
            self.note(CHOICE, f"{len(wanted)} joints locked: {', '.join(wanted)}", "at their start, as asked")
        idle = [name for name in idle if name not in wanted]
        if len(idle) + len(wanted) == robot.model.njoints - 1:
            why = "no joint is asked for anything, and a robot without joints is none"
            self.decisions.append(Decision(kind=KEPT, what="all other joints", why=why))
        elif idle:
            self.reduce(locked(robot, [*wanted, *idle], contacts, self.whole.initial_q))
            why = (
                "at their start: no contact, goal, clearance or other target needs them; they shift no weight"
            )
            self.note(CHOICE, f"{len(idle)} joints locked: {', '.join(idle)}", why)
        asked = [name for name in self.keep if self.needs.get(name) == KEPT_AS_ASKED]
        if asked:
            what = f"joints {', '.join(asked)}, as asked"
            self.decisions.append(Decision(kind=KEPT, what=what, why="nothing else needs them"))

    def halve(self) -> None:
        """The half in the plane, if the robot and the task are symmetric."""
        if self.plane is False or (self.plane == "auto" and self.whole.robot.base != "freeflyer"):
            return
        try:
            half = halved(self.problem, self._kept())
        except InputError as error:
            if self.plane is True:
                raise
            self.decisions.append(Decision(kind=KEPT, what="left and right apart", why=str(error)))
            return
        self._apply(half)
        flat = flattened(self.problem, self._kept())
        if flat.reduction is not None:
            self.reduce(chained(self.reduction, flat.reduction))
            self.note(CHOICE, flat.what, flat.why)
        if flat.refused:
            self.decisions.append(Decision(kind=KEPT, what="joints that leave the plane", why=flat.refused))

    def _apply(self, half: Halved) -> None:
        self.reduce(chained(self.reduction, half.reduction))
        self.note(half.kind, half.what, half.why)

    def _kept(self) -> tuple[str, ...]:
        """Joints to keep by the names that they have now."""
        followers = self.reduction.joints
        return tuple(followers[name].name for name in self.keep if name in followers)

    def drop_torques(self) -> None:
        made = without_torques(self.problem)
        if made is not None:
            self.problem = made
            self.note(EXACT, "joint torques", "no term limits, prices or uses them: accelerations are inputs")

    def report(self) -> SceneReport:
        made = transcribe(self.problem, *self.grid)
        return SceneReport(
            problem=self.original.name,
            robot=self.original.robot.name,
            modelled=modelled(self.problem, self.whole, self.needs),
            decisions=tuple(self.decisions),
            before=self.before,
            after=Size(variables=made.layout.n_unknowns, rows=made.n_rows),
            transcription=made.layout.mesh.transcription,
            intervals=made.layout.n_intervals,
        )
