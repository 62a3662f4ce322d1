"""The report of a check: figures with units, tolerances with reasons, and a readable table."""

import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from trajopt.certify.figures import Figure, MeasuredFigure, figure
from trajopt.dynamics.virtual_base import LEAST_MARGIN
from trajopt.motion.meta import jsonable
from trajopt.motion.samples import largest_known
from trajopt.motion.traces import Occurrence

# Residuals and forces of inactive contacts over the weight, contact accelerations over g: what a solver with
# tolerance 1e-6 leaves, in units of weight and length.
RESIDUAL = 1e-6
# Friction, unilateral and sole margins may be negative by this fraction of the weight, for the same reason.
FRICTION = 1e-6
# Limits may be exceeded by this fraction, for the same reason.
LIMIT = 1e-6
# Between points, margins may be negative by this fraction of the weight, and limits may be exceeded by this
# fraction: below the uncertainty of friction coefficients and motors.
BETWEEN = 1e-2
# Changes of a torque over its limit, 1/s, from which it chatters. The library's least-time motions take 9.
CHATTER = 20.0
# The local errors of a phase's intervals may sum to this fraction of the robot's reach, and to this many rad:
# what feedback has to correct is then below the positioning accuracy of legs.
LOCAL_POSITION = 1e-3
LOCAL_JOINTS = 5e-3
# The open loop is judged if it amplifies local errors by less than this. Beyond, a motion is unstable without
# feedback, and its open loop says nothing about the plan.
STABLE_GROWTH = 30.0
# Open-loop error of a stable phase, m and rad: the positioning accuracy of legs and of their joints.
OPEN_LOOP_POSITION = 1e-3
OPEN_LOOP_ORIENTATION = 2e-3
OPEN_LOOP_JOINTS = 5e-3
# A foot that drifts or hovers by a millimetre within a phase is within the positioning accuracy of legs.
FOOT_DRIFT = 1e-3
# A sole of 10 cm half length that is tilted by this lifts its edge by a millimetre.
SOLE_TILT = 1e-2
# A foot a millimetre deep is below the compliance of rubber soles.
PENETRATION = 1e-3
# Norm error of quaternions and (cos, sin) pairs: rounding over thousands of steps is 1e-12.
QUATERNION = 1e-8
# Smallest margin of a virtual base to gimbal lock: below it the rates of the angles are over twenty times the
# angular velocity, and the plan is unreliable between its samples.
GIMBAL = LEAST_MARGIN
OPEN_LOOP = ("open_loop_position", "open_loop_orientation", "open_loop_joints")


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Largest allowed figures of a plan; None reports a figure without judging it."""

    residual: float | None = RESIDUAL
    friction: float | None = FRICTION
    limit: float | None = LIMIT
    between: float | None = BETWEEN
    local_position: float | None = LOCAL_POSITION
    local_joints: float | None = LOCAL_JOINTS
    foot_drift: float | None = FOOT_DRIFT
    stance_drift: float | None = FOOT_DRIFT
    foot_turn: float | None = SOLE_TILT
    sole_tilt: float | None = SOLE_TILT
    penetration: float | None = PENETRATION
    bodies: float | None = PENETRATION
    quaternion: float | None = QUATERNION
    gimbal: float | None = GIMBAL
    flight: float | None = None
    open_loop_position: float | None = OPEN_LOOP_POSITION
    open_loop_orientation: float | None = OPEN_LOOP_ORIENTATION
    open_loop_joints: float | None = OPEN_LOOP_JOINTS


# Tolerances of a motion that holds at all times, and of one on a fixed mesh, which holds at its points.
GRADE = Tolerances()
AT_POINTS = Tolerances(
    between=None,
    bodies=None,
    local_position=None,
    local_joints=None,
    stance_drift=None,
    foot_turn=None,
    open_loop_position=None,
    open_loop_orientation=None,
    open_loop_joints=None,
)


@dataclass(frozen=True, kw_only=True)
class PhaseReport:
    """Figures of one phase: open-loop errors (m, rad, rad), and in flight the errors of free motion.

    ``local_position`` (reach) and ``local_joints`` (rad) are sums of the local errors of its intervals.
    ``stable`` says whether the open loop amplifies them by at most `STABLE_GROWTH`; None if not integrated.
    Unless all phases are integrated, that of an unstable phase ends early and gives no open-loop errors.
    """

    index: int
    name: str
    start: float
    end: float
    contacts: tuple[str, ...]
    local_position: float
    local_joints: float
    stable: bool | None
    open_loop_position: float | None
    open_loop_orientation: float | None
    open_loop_joints: float | None
    ballistic_error: float | None
    momentum_error: float | None
    ballistic_error_between: float | None
    momentum_error_between: float | None


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """Worst figures of a solution, see ``FIGURES`` for their units; None if a figure does not apply.

    Figures are taken at collocation points; ``..._between`` is the same figure at all times, see `dense`.
    ``places`` has the place where each figure is worst, by name.

    Attributes:
        base_residual, actuated_residual: RNEA(q, v, a) - sum J^T f (minus tau); force rows over the weight
            m g, moment rows over the weight times 1 m. With velocity sources the base rows are static,
            RNEA(q, 0, 0) - sum J^T f.
        contact_acceleration: Classical acceleration of active contacts over g (angular rows of soles in
            rad/s^2 over g per metre); with velocity sources, their velocity over sqrt(g 1 m).
        friction_margin, unilateral_margin: Least mu f_n - |f_t| and least f_n on the contact's surface; not
            for bilateral contacts, like sole_margin.
        sole_margin: Least distance of moments from the sole's limits.
        term_excess: Largest violation of a term that only the solve could evaluate, as its statistics state
            it; see `TermExcess`.
        sliding_friction: Largest difference between the force of a sliding contact and the law of
            `trajopt.terms.dynamics`. Acceleration, velocity and drift of such contacts are along the normal.
        effort_excess, velocity_excess: Largest |x| / limit - 1; negative is reserve.
        torque_variation, torque_reversals: Sum of |change| / limit over the samples for the joint where it is
            largest, and how often that torque turns by more than 1 % of its limit; see ``chatter``.
        drive_torque_excess: Largest |tau_m| / torque_limit - 1 of the drives, with joint friction.
        drive_voltage_excess: Largest |tau_m / stall_torque + omega_m / no_load_speed| - 1.
        acceleration_use, jerk_use, torque_rate_use: Largest |x| / limit of joints that have one, the last two
            where jerks are the input. Limits that are terms of the problem are judged as ``term_excess``.
        position_excess: Largest excess over a limit, over the joint's range; negative is reserve. This and
            velocity_excess are at all samples.
        following_error: Largest deviation of a mimic joint, m or rad, at all times.
        local_position, local_joints: Largest sum over a phase of the local errors of its intervals, position
            over the reach and rotations in rad, see `accuracy.local_errors`.
        impact_residual: M (v+ - v-) - J^T Lambda over mass times sqrt(g 1 m) (moments: times 1 m).
        impact_velocity: J v+ over sqrt(g 1 m).
        impact_friction_margin: Least mu Lambda_n - |Lambda_t|.
        impact_momentum_error: Change of linear and angular momentum minus the impulses (floating bases).
        impact_energy_gain: Largest change of kinetic energy; negative if all impacts lose energy.
        state_jump: Largest jump of q between intervals, and of v without an impact, see `impact_figures`.
        quaternion_error, contact_velocity: At all samples.
        penetration, foot_drift, stance_drift, foot_turn, sole_tilt: At all times. Penetration is below the
            surface of an active contact, below the terrain otherwise; on curved ground, below the tangent
            plane of the highest ground under the contact.
        link_depth, obstacle_distance, self_distance: Of the file's link shapes (and capsules of a problem
            with obstacles), by Coal, at all times; a negative depth is a distance. Files without shapes only
            have the figures of their capsules, and ``notes`` say so.
        clearance_margin: Least distance of links from obstacles and each other minus that required by the
            problem's `Clearance`; None without a margin.
        landing_height: Unsigned distance of active contacts from their surface at their phase's start.
        patch_margin: Least distance of active contacts (soles: corners) inside their patches, at all times.
        position_gap, velocity_gap: See `integration_gaps.interval_gaps`.
        ballistic_error, momentum_error: At nodes, ``..._between`` at collocation points, see
            `flight.flight_errors`.
        open_loop_...: See `reintegration.open_loop`; inf if it diverges.
    """

    base_residual: float | None = figure("base rows of the dynamics", "weight", "residual")
    actuated_residual: float | None = figure("actuated rows of the dynamics", "weight", "residual")
    contact_acceleration: float | None = figure("acceleration of active contacts", "g", "residual")
    contact_velocity: float | None = figure("velocity of active contacts", "m/s", why="see drift")
    friction_margin: float | None = figure("friction margin", "weight", "friction", margin=True)
    friction_margin_between: float | None = figure(
        "friction margin between points", "weight", "between", margin=True
    )
    unilateral_margin: float | None = figure("least normal force", "weight", "friction", margin=True)
    unilateral_margin_between: float | None = figure(
        "least normal force between points", "weight", "between", margin=True
    )
    sole_margin: float | None = figure("sole margin", "weight m", "friction", margin=True)
    sole_margin_between: float | None = figure(
        "sole margin between points", "weight m", "between", margin=True
    )
    sliding_friction: float | None = figure("law of sliding friction", "weight", "residual")
    sliding_friction_between: float | None = figure(
        "law of sliding friction between points", "weight", "between"
    )
    term_excess: float | None = figure("own terms beyond bounds between points", "unit", "between")
    inactive_force: float | None = figure("force of inactive contacts", "weight", "residual")
    effort_excess: float | None = figure("torque beyond its limit", "limit", "limit")
    effort_excess_between: float | None = figure("torque beyond its limit between points", "limit", "between")
    drive_torque_excess: float | None = figure("motor torque beyond its limit", "limit", "limit")
    drive_torque_excess_between: float | None = figure(
        "motor torque beyond its limit between points", "limit", "between"
    )
    drive_voltage_excess: float | None = figure("motor voltage beyond its limit", "limit", "limit")
    drive_voltage_excess_between: float | None = figure(
        "motor voltage beyond its limit between points", "limit", "between"
    )
    torque_variation: float | None = figure("sum of changes of a torque", "limit", why="smoothness")
    torque_reversals: float | None = figure("turns of this torque", "", why="smoothness")
    velocity_excess: float | None = figure("velocity beyond its limit", "limit", "limit")
    velocity_excess_between: float | None = figure(
        "velocity beyond its limit between samples", "limit", "between"
    )
    position_excess: float | None = figure("position beyond its limit", "range", "limit")
    position_excess_between: float | None = figure(
        "position beyond its limit between samples", "range", "between"
    )
    acceleration_use: float | None = figure("largest acceleration", "limit", why="not judged")
    jerk_use: float | None = figure("largest jerk", "limit", why="not judged")
    torque_rate_use: float | None = figure("largest rate of torque", "limit", why="not judged")
    following_error: float | None = figure("joints from where they follow others", "m, rad", "residual")
    penetration: float | None = figure("depth below the terrain", "m", "penetration")
    link_depth: float | None = figure("depth of links in the ground", "m", "bodies")
    obstacle_distance: float | None = figure("least distance from obstacles", "m", "bodies", margin=True)
    self_distance: float | None = figure("least distance between links", "m", "bodies", margin=True)
    clearance_margin: float | None = figure(
        "distance beyond the margin asked for", "m", "bodies", margin=True
    )
    landing_height: float | None = figure("height of contacts where they begin", "m", "foot_drift")
    patch_margin: float | None = figure("distance inside the patch", "m", "foot_drift", margin=True)
    foot_drift: float | None = figure("drift of active contacts", "m", "foot_drift")
    stance_drift: float | None = figure("drift from touchdown to lift-off", "m", "stance_drift")
    foot_turn: float | None = figure("turn of active soles", "rad", "foot_turn")
    sole_tilt: float | None = figure("tilt of active soles on their surface", "rad", "sole_tilt")
    impact_residual: float | None = figure("law of the impacts", "momentum", "residual")
    impact_velocity: float | None = figure("velocity of contacts after impacts", "speed", "residual")
    impact_friction_margin: float | None = figure(
        "friction margin of impulses", "momentum", "friction", margin=True
    )
    impact_momentum_error: float | None = figure("momentum across impacts", "momentum, 1 m", "residual")
    impact_energy_gain: float | None = figure("energy gained in impacts", "weight m", "residual")
    state_jump: float | None = figure("jump of state without impact", "m, rad, speed", "residual")
    periodicity_error: float | None = figure("last state against the first", "m, rad, speed", "residual")
    quaternion_error: float | None = figure("norm error of rotations", "1", "quaternion")
    gimbal_margin: float | None = figure("margin to gimbal lock", "1", "gimbal", least=True)
    position_gap: float | None = figure("q against the integral of v", "m, rad", why="see local errors")
    velocity_gap: float | None = figure("v against the integral of a", "m/s, rad/s", why="see local errors")
    ballistic_error: float | None = figure(
        "flight against the parabola", "travel", "flight", why="see local errors"
    )
    momentum_error: float | None = figure(
        "angular momentum in flight", "scale", "flight", why="see local errors"
    )
    ballistic_error_between: float | None = figure(
        "flight against the parabola, between nodes", "travel", why="see local errors"
    )
    momentum_error_between: float | None = figure(
        "angular momentum in flight, between nodes", "scale", why="see local errors"
    )
    local_position: float | None = figure("local errors of a phase, position", "reach", "local_position")
    local_joints: float | None = figure("local errors of a phase, rotations", "rad", "local_joints")
    open_loop_position: float | None = figure("open loop, base position", "m", "open_loop_position")
    open_loop_orientation: float | None = figure(
        "open loop, base orientation", "rad", "open_loop_orientation"
    )
    open_loop_joints: float | None = figure("open loop, joints", "rad", "open_loop_joints")
    places: dict[str, Occurrence] = field(default_factory=dict)
    phases: tuple[PhaseReport, ...]
    notes: tuple[str, ...] = ()
    simulated: bool = False

    @property
    def ok(self) -> bool:
        """Whether all judged figures are within the default tolerances."""
        return self.within()

    def within(self, tolerances: Tolerances | None = None) -> bool:
        """Return whether every judged figure is within ``tolerances`` (default: `Tolerances`)."""
        return not self.failures(tolerances)

    def failures(self, tolerances: Tolerances | None = None) -> tuple[str, ...]:
        """Return the names of the figures that exceed their tolerance."""
        limits = tolerances or Tolerances()
        return tuple(name for name in FIGURES if self._fails(name, limits))

    @property
    def chatter(self) -> str:
        """What to say of a torque that changes by more than `CHATTER` limits a second; empty otherwise.

        One that switches between its limits, and so changes by more than a limit from turn to turn, does not
        chatter.
        """
        sums, place = self.torque_variation, self.places.get("torque_variation")
        duration = self.phases[-1].end - self.phases[0].start if self.phases else 0.0
        if sums is None or place is None or not sums > CHATTER * duration > 0:
            return ""
        if (self.torque_reversals or 0.0) < sums:
            return ""
        rate = f"{sums / duration:.0f} limits a second, with {self.torque_reversals:.0f} turns"
        remedy = "larger weights on accelerations or torques calm it"
        return f"the torque of {place.name} changes by {rate}: {remedy}"

    def verdict(self, tolerances: Tolerances | None = None) -> str:
        """Return in one sentence whether the motion holds, or why not, and what is not judged."""
        failures = self.failures(tolerances)
        text = "holds at all times"
        if failures:
            more = f", and {len(failures) - 1} more" if len(failures) > 1 else ""
            text = f"does not hold: {self.in_words(self.worst(tolerances)[0])}{more}"
        unstable = [phase.name for phase in self.phases if phase.stable is False]
        if unstable:
            text += f"; {', '.join(unstable)} is unstable without feedback, so its open loop is not judged"
        return f"verdict: {'a simulated run, which as a plan ' if self.simulated else ''}{text}"

    def worst(self, tolerances: Tolerances | None = None) -> tuple[str, float]:
        """Return name and ratio of the figure with the largest ratio to its tolerance (above 1: exceeded)."""
        used = self.used(tolerances)
        name = max(used, key=lambda name: math.inf if math.isnan(used[name]) else used[name])
        return name, used[name]

    def used(self, tolerances: Tolerances | None = None) -> dict[str, float]:
        """Return the ratio of every judged figure to its tolerance."""
        limits = tolerances or Tolerances()
        return {name: ratio for name in FIGURES if (ratio := self._ratio(name, limits)) is not None}

    def figures(self, tolerances: Tolerances | None = None) -> tuple[MeasuredFigure, ...]:
        """Return the figures that apply, with their limits and verdicts."""
        limits, measured = tolerances or Tolerances(), []
        for name, shown in FIGURES.items():
            value = getattr(self, name)
            limit = None if shown.tolerance is None else getattr(limits, shown.tolerance)
            if value is None:
                continue
            fails = self._fails(name, limits)
            # An open loop is judged in stable phases alone.
            idle = name in OPEN_LOOP and limit is not None and value > limit and not fails
            measured.append(
                MeasuredFigure(
                    text=shown.text,
                    value=value,
                    unit=shown.unit,
                    limit=None if idle else -limit if shown.margin and limit is not None else limit,
                    lower=shown.margin or shown.least,
                    why="unstable" if idle else shown.why,
                    beyond=fails,
                    place=self.places.get(name),
                )
            )
        return tuple(measured)

    def in_words(self, name: str) -> str:
        """Return a figure in words: text, value, unit and place."""
        figure, place = FIGURES[name], self.places.get(name)
        where = "" if place is None else f" at {place}"
        return f"{figure.text} {getattr(self, name):.2g} {figure.unit}{where}"

    def _fails(self, name: str, tolerances: Tolerances) -> bool:
        ratio = self._ratio(name, tolerances)
        return ratio is not None and not ratio <= 1

    def _ratio(self, name: str, tolerances: Tolerances) -> float | None:
        """Return the ratio of a figure to its tolerance; None if it is not judged."""
        figure, value = FIGURES[name], getattr(self, name)
        limit = None if figure.tolerance is None else getattr(tolerances, figure.tolerance)
        if name in OPEN_LOOP:
            value = largest_known(getattr(phase, name) for phase in self.phases if phase.stable)
        if limit is None or value is None:
            return None
        if figure.least:
            return float(limit / value if value > 0 else math.nan if math.isnan(value) else math.inf)
        return float((-value if figure.margin else value) / limit)

    def to_dict(self, tolerances: Tolerances | None = None) -> dict[str, Any]:
        """Return JSON-able figures by name, with verdict, phases and notes; inf and NaN become null."""
        failures = self.failures(tolerances)
        judged = {"ok": not failures, "failures": failures, "verdict": self.verdict(tolerances)}
        return jsonable(judged | asdict(self))

    def table(self, tolerances: Tolerances | None = None) -> str:
        """Return one figure a line with unit, tolerance and verdict, then the phases and notes."""
        lines = [f"{'':42}{'value':>12}  {'unit':14}{'tolerance':>10}          worst at"]
        lines += [figure.line(42) for figure in self.figures(tolerances)]
        for phase in self.phases:
            lines.append(_phase_line(phase))
        lines += [f"note: {text}" for text in (*self.notes, *filter(None, [self.chatter]))]
        return "\n".join(lines)

    def __str__(self) -> str:
        return f"{self.table()}\n{self.verdict()}"


FIGURES: dict[str, Figure] = {
    entry.name: entry.metadata["figure"] for entry in fields(CheckReport) if "figure" in entry.metadata
}


def _phase_line(phase: PhaseReport) -> str:
    names = ", ".join(phase.contacts) or "no contact"
    errors = [
        (phase.open_loop_position, "m"),
        (phase.open_loop_orientation, "rad"),
        (phase.open_loop_joints, "rad"),
    ]
    sizes = ", ".join(f"{value:.1e} {unit}" for value, unit in errors if value is not None)
    unstable = ", unstable without feedback" if phase.stable is False else ""
    local = f"local {phase.local_position:.1e} reach, {phase.local_joints:.1e} rad"
    loop = f"; open loop {sizes}{unstable}" if sizes else ""
    return f"phase {phase.index} ({phase.start:.3f} to {phase.end:.3f} s, {names}): {local}{loop}"
