"""Advice: for each finding, one sentence on what to try."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from trajopt.solving.diagnosis.diagnosis import Advice
from trajopt.transcription.names import BOUNDS

if TYPE_CHECKING:
    from trajopt.solving.diagnosis.conflict import Conflict
    from trajopt.solving.diagnosis.diagnosis import Diagnosis
    from trajopt.solving.diagnosis.findings import DependentRows

# Blocks of rows that express goals.
GOALS = (
    "frame_pose",
    "frame_velocity",
    "terminal_state",
    "terminal_rest",
    "terminal_velocity",
    "terminal_posture",
    "frame_height",
    "swing_clearance",
    "contact_landing",
    "periodicity",
)
CONTACTS = ("contact_acceleration", "contact_velocity", "contact_landing", "impact_dynamics")
# Remedies for limits that conflict with a goal.
REMEDIES = {
    "velocity_limits": "lengthen the phase, or raise the velocity limit",
    "torque_limits": "lengthen the phase, raise the torque limit, or carry less",
    "position_limits": "choose a goal within the joint's range, or start from another posture",
    "friction_pyramid": "raise the friction, accelerate less, or use FrictionCone, which holds more",
    "friction_cone": "raise the friction, or accelerate less",
    "sole_limits": "move slower, or make the sole larger",
    "sole_cone": "move slower, raise the friction, or make the sole larger",
    "duration": "widen the bounds of the total duration",
    BOUNDS: "widen that bound",
}
BOUND_OF = {"rate": "velocity_limits", "position": "position_limits"}
# A limit that is active at this fraction of its places determines the motion; number of such limits to name.
SATURATED_SHARE, MOST_SATURATED = 0.5, 3
# Largest error of an interval, m, on a mesh that is fine enough: the check's tolerance on drift.
COARSE = 1e-3
# Condition number of active rows beyond which solvers lose half of their digits.
ILL_CONDITION = 1e8
# Costs that give curvature to each kind of variable.
CURVATURE_COSTS = {
    "force": "WrenchCost",
    "moment": "WrenchCost",
    "impulse": "ImpulseCost",
    "angular impulse": "ImpulseCost",
    "acceleration": "AccelerationCost",
    "jump": "VelocityCost",
    "rate": "VelocityCost or AccelerationCost",
    "position": "PostureCost",
    "time scale": "TimeCost, or bounds on the duration",
}


def advice(diagnosis: Diagnosis) -> Iterator[Advice]:
    """Yield the advice for a diagnosis, most urgent first."""
    yield from _of_values(diagnosis)
    yield from _of_conflict(diagnosis)
    yield from _of_rows(diagnosis)
    yield from _of_contacts(diagnosis)
    yield from _of_curvature(diagnosis)
    yield from _of_scaling(diagnosis)
    yield from _of_mesh(diagnosis)
    yield from _of_limits(diagnosis)
    for text in diagnosis.start:
        exactly = "exactly on" in text
        remedy = "move it inside by a little" if exactly else "start within the limits"
        if not exactly or not diagnosis.solved:
            yield Advice(text, remedy)


def _of_values(diagnosis: Diagnosis) -> Iterator[Advice]:
    wrong = diagnosis.nonfinite
    if wrong is None:
        return
    finding = str(wrong)
    if any(entry.value != entry.value for entry in wrong.inputs):
        yield Advice(finding, "the guess itself is not finite there: correct the guess")
    elif wrong.inputs:
        yield Advice(
            finding,
            "keep that input where the term is defined: another guess, a bound, or a term that is "
            "smooth there",
        )
    else:
        yield Advice(finding, "give the term values and slopes there, or start elsewhere")


def _of_rows(diagnosis: Diagnosis) -> Iterator[Advice]:
    for group in diagnosis.dependent:
        yield Advice(str(group), _untangled(group))
    for report in diagnosis.ranks:
        if report.condition is not None and report.condition > ILL_CONDITION and report.full:
            where = "all phases together" if report.phase is None else f"phase '{report.phase}'"
            yield Advice(
                f"active rows of {where} are nearly dependent, condition {report.condition:.1e}",
                "look for goals that almost repeat contacts or limits, and for singular postures",
            )


def _untangled(group: DependentRows) -> str:
    if group.fixed:
        return "they constrain only the fixed start, which meets them or not: remove them, or free the start"
    goals = [block for block in group.blocks if block in GOALS and block != "contact_landing"]
    others = [block for block in group.blocks if block not in (*GOALS, *CONTACTS, "defect")]
    if all(block in CONTACTS for block in group.blocks):
        return (
            "contacts fix each other: hold fewer of their rows (redundancy elimination leaves such rows out)"
        )
    if goals and not others and any(block in CONTACTS for block in group.blocks):
        return f"{' and '.join(goals)} constrain what contacts fix: keep only directions that they leave free"
    if goals and not others and len(group.rows) > 1:
        return f"goals repeat each other ({', '.join(goals)}): remove one of them"
    if not group.equations:
        return "active limits leave too little freedom: raise one of them, or relax the goal"
    return "the same constraint is stated twice: remove one of these rows"


def _of_conflict(diagnosis: Diagnosis) -> Iterator[Advice]:
    clash = diagnosis.conflict
    if not diagnosis.worst or diagnosis.nonfinite is not None:
        return
    if clash is None:
        yield Advice(f"violated: {diagnosis.worst[0].row}", "another start, or an easier goal first")
        return
    misses = (
        f"rows are violated by {clash.before:.2e} in sum, which a small step reduces to {clash.after:.2e}"
    )
    if clash.is_early:
        yield Advice(
            misses,
            "the iterate is early and shows no conflict: more iterations or another start",
        )
        return
    goal = any(party.block in GOALS for party in clash.giving)
    kind = "goal out of reach" if goal else "rows contradict each other"
    against = (_remedy(one.block, one.what, f"ask less of {one.block}") for one in clash.against[:3])
    remedies = list(dict.fromkeys(against))
    if not clash.is_conflict or diagnosis.status is None:  # at a guess, the linearisation is not reliable
        kind = f"{misses}; left are"
        remedies = ["more iterations, or an easier goal first and its solution as the start", *remedies]
    finding = f"{kind}: {_parties(clash)}"
    yield Advice(finding, "; ".join(remedies) or "bring the goal nearer, or give it more time")


def _parties(clash: Conflict) -> str:
    giving = ", ".join(f"{party.what} ({party.amount:.1e})" for party in clash.giving[:3])
    where = f" at {clash.giving[0].place}" if clash.giving else ""
    against = ", ".join(party.what for party in clash.against[:3])
    return f"{giving}{where}" + (f"; against it stand {against}" if against else "")


def _remedy(block: str, what: str, otherwise: str) -> str:
    """Return the remedy for a block; bounds on nodal rates or positions count as limits at points."""
    if block == BOUNDS:
        block = next((limits for word, limits in BOUND_OF.items() if word in what), block)
    return REMEDIES.get(block, otherwise)


def _of_contacts(diagnosis: Diagnosis) -> Iterator[Advice]:
    for phase in diagnosis.contacts:
        if phase.singular and not diagnosis.solved:
            yield Advice(
                f"phase '{phase.phase}': {phase}",
                "postures there are singular, such as a straight leg: bend it in the guess and at the "
                "start, or narrow the position limits",
            )


def _of_curvature(diagnosis: Diagnosis) -> Iterator[Advice]:
    curved = diagnosis.curvature
    if curved is None:
        return
    if curved.negative and curved.known:
        yield Advice(
            f"the Lagrangian has negative curvature, {curved.smallest_along[0]}: this is no minimum",
            "start from a perturbed guess (`perturb=0.1`), or solve further from here",
        )
    if curved.flat_along:
        flat = curved.flat_along[0]
        costs = dict.fromkeys(CURVATURE_COSTS.get(kind, "a cost on it") for kind in flat.kinds[:2])
        yield Advice(
            f"no cost has curvature, {flat}",
            f"add a small {' or '.join(costs)}: what no cost depends on is not unique",
        )


def _of_scaling(diagnosis: Diagnosis) -> Iterator[Advice]:
    if diagnosis.scaling is None:
        return
    for block in diagnosis.scaling.worst_blocks[:2]:
        much = block.multiplier is not None and block.multiplier.largest > max(1.0, block.row_norm.far)
        if much and not diagnosis.feasible:  # they only reflect how infeasible the rows are
            continue
        what = f"multipliers {block.multiplier}" if much else f"row norms {block.row_norm}"
        yield Advice(
            f"{block.block} is far from scale one, {what}",
            "give its rows the unit of what they measure"
            if not much
            else "look at weights of costs far from one, or a constraint that can hardly be met",
        )
    for kind in diagnosis.scaling.worst_kinds[:1]:
        yield Advice(
            f"variables of kind {kind.kind} are far from scale one: values {kind.value}, "
            f"columns {kind.column_norm}",
            "measure from a nearer origin, or look at masses and lengths of the robot",
        )


def _of_mesh(diagnosis: Diagnosis) -> Iterator[Advice]:
    for phase, error in (diagnosis.local_error or {}).items():
        if not error <= COARSE:
            yield Advice(
                f"one interval of phase '{phase}' has an error of {error:.1e} m",
                "the mesh is too coarse there: more intervals, or a scheme of higher order",
            )


def _of_limits(diagnosis: Diagnosis) -> Iterator[Advice]:
    tried = diagnosis.status is not None and not diagnosis.solved  # limits of a guess are meaningless
    saturated = 0
    for limit in diagnosis.limits:
        decides = limit.of > 1 and limit.places >= SATURATED_SHARE * limit.of and not limit.weak
        duration = limit.about.endswith("duration") or limit.block == "duration"
        if duration and not limit.weak:
            yield Advice(
                f"{limit.about} is at its {limit.side} bound",
                "widen that bound if the optimum may choose its time",
            )
        elif saturated < MOST_SATURATED and decides and tried:
            saturated += 1
            yield Advice(
                f"{limit.block} [{limit.about}] is at its {limit.side} bound for {limit.places} of "
                f"{limit.of} places of phase '{limit.phase}'",
                _remedy(limit.block, limit.about, "raise it, or ask for less"),
            )
