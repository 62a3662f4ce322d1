"""The report of a check: figures with units, tolerances with reasons, a readable table."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from trajopt.dynamics.virtual_base import LEAST_MARGIN

# Residuals, contact accelerations and forces of inactive contacts, as parts of the weight (of
# gravity): what a solver leaves that stops at 1e-6 in units of weight and length.
RESIDUAL = 1e-6
# Friction, unilateral and sole margins may be negative by this part of the weight, for the same reason.
FRICTION = 1e-6
# Limits may be exceeded by this part of themselves, for the same reason.
LIMIT = 1e-6
# A foot that creeps or hovers a millimetre within a phase is below what legs are positioned to.
FOOT_DRIFT = 1e-3
# A sole of 10 cm half length that is tilted by this lifts its edge by a millimetre.
SOLE_TILT = 1e-2
# A foot a millimetre deep is below the compliance of rubber soles.
PENETRATION = 1e-3
# Norm error of quaternions and (cos, sin) pairs: rounding over thousands of steps is 1e-12.
QUATERNION = 1e-8
# A virtual base must keep this margin to gimbal lock: below it the angles' rates are over twenty times the
# angular velocity, and the plan between its samples means little.
GIMBAL = LEAST_MARGIN


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Largest values of a trustworthy plan; None reports a figure without judging it."""

    residual: float | None = RESIDUAL
    friction: float | None = FRICTION
    limit: float | None = LIMIT
    foot_drift: float | None = FOOT_DRIFT
    sole_tilt: float | None = SOLE_TILT
    penetration: float | None = PENETRATION
    quaternion: float | None = QUATERNION
    gimbal: float | None = GIMBAL
    flight: float | None = None
    open_loop_position: float | None = None
    open_loop_orientation: float | None = None
    open_loop_joints: float | None = None


@dataclass(frozen=True, kw_only=True)
class PhaseReport:
    """Figures of one phase: open-loop errors (m, rad, rad), and in flight the errors of free motion."""

    index: int
    start: float
    end: float
    contacts: tuple[str, ...]
    open_loop_position: float | None
    open_loop_orientation: float | None
    open_loop_joints: float
    ballistic_error: float | None
    momentum_error: float | None
    ballistic_error_between: float | None
    momentum_error_between: float | None


@dataclass(frozen=True, kw_only=True)
class Figure:
    """How one number of the report reads: what, unit, which tolerance judges it."""

    text: str
    unit: str
    tolerance: str | None = None
    margin: bool = False  # a margin must not be less than minus the tolerance
    least: bool = False  # the tolerance is the least that is allowed


FIGURES: dict[str, Figure] = {
    "base_residual": Figure(text="base rows of the dynamics", unit="weight", tolerance="residual"),
    "actuated_residual": Figure(text="actuated rows of the dynamics", unit="weight", tolerance="residual"),
    "contact_acceleration": Figure(text="acceleration of active contacts", unit="g", tolerance="residual"),
    "contact_velocity": Figure(text="velocity of active contacts", unit="m/s"),
    "friction_margin": Figure(text="friction margin", unit="weight", tolerance="friction", margin=True),
    "friction_margin_between": Figure(text="friction margin between points", unit="weight", margin=True),
    "unilateral_margin": Figure(text="least normal force", unit="weight", tolerance="friction", margin=True),
    "sole_margin": Figure(text="sole margin", unit="weight m", tolerance="friction", margin=True),
    "sliding_friction": Figure(text="law of sliding friction", unit="weight", tolerance="residual"),
    "inactive_force": Figure(text="force of inactive contacts", unit="weight", tolerance="residual"),
    "effort_excess": Figure(text="torque beyond its limit", unit="limit", tolerance="limit"),
    "effort_excess_between": Figure(text="torque beyond its limit between points", unit="limit"),
    "drive_torque_excess": Figure(text="motor torque beyond its limit", unit="limit", tolerance="limit"),
    "drive_voltage_excess": Figure(text="motor voltage beyond its limit", unit="limit", tolerance="limit"),
    "drive_voltage_excess_between": Figure(
        text="motor voltage beyond its limit between points", unit="limit"
    ),
    "velocity_excess": Figure(text="velocity beyond its limit", unit="limit", tolerance="limit"),
    "position_excess": Figure(text="position beyond its limit", unit="range", tolerance="limit"),
    "penetration": Figure(text="depth below the terrain", unit="m", tolerance="penetration"),
    "obstacle_distance": Figure(
        text="least distance from obstacles", unit="m", tolerance="penetration", margin=True
    ),
    "self_distance": Figure(
        text="least distance between links", unit="m", tolerance="penetration", margin=True
    ),
    "landing_height": Figure(text="height of contacts where they begin", unit="m", tolerance="foot_drift"),
    "patch_margin": Figure(text="distance inside the patch", unit="m", tolerance="foot_drift", margin=True),
    "foot_drift": Figure(text="drift of active contacts", unit="m", tolerance="foot_drift"),
    "stance_drift": Figure(text="drift from touchdown to lift-off", unit="m"),
    "foot_turn": Figure(text="turn of active soles", unit="rad"),
    "sole_tilt": Figure(text="tilt of active soles on their surface", unit="rad", tolerance="sole_tilt"),
    "impact_residual": Figure(text="law of the impacts", unit="momentum", tolerance="residual"),
    "impact_velocity": Figure(text="velocity of contacts after impacts", unit="speed", tolerance="residual"),
    "impact_friction_margin": Figure(
        text="friction margin of impulses", unit="momentum", tolerance="friction", margin=True
    ),
    "impact_momentum_error": Figure(
        text="momentum across impacts", unit="momentum, 1 m", tolerance="residual"
    ),
    "impact_energy_gain": Figure(text="energy gained in impacts", unit="weight m", tolerance="residual"),
    "state_jump": Figure(text="jump of state without impact", unit="m, rad, speed", tolerance="residual"),
    "periodicity_error": Figure(
        text="last state against the first", unit="m, rad, speed", tolerance="residual"
    ),
    "quaternion_error": Figure(text="norm error of rotations", unit="1", tolerance="quaternion"),
    "gimbal_margin": Figure(text="margin to gimbal lock", unit="1", tolerance="gimbal", least=True),
    "position_gap": Figure(text="q against the integral of v", unit="m, rad"),
    "velocity_gap": Figure(text="v against the integral of a", unit="m/s, rad/s"),
    "ballistic_error": Figure(text="flight against the parabola", unit="travel", tolerance="flight"),
    "momentum_error": Figure(text="angular momentum in flight", unit="scale", tolerance="flight"),
    "ballistic_error_between": Figure(text="flight against the parabola, between nodes", unit="travel"),
    "momentum_error_between": Figure(text="angular momentum in flight, between nodes", unit="scale"),
    "open_loop_position": Figure(text="open loop, base position", unit="m", tolerance="open_loop_position"),
    "open_loop_orientation": Figure(
        text="open loop, base orientation", unit="rad", tolerance="open_loop_orientation"
    ),
    "open_loop_joints": Figure(text="open loop, joints", unit="rad", tolerance="open_loop_joints"),
}


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """Worst figures of a solution, see ``FIGURES`` for their units; None where there is nothing to measure.

    base_residual, actuated_residual: RNEA(q, v, a) - sum J^T f (minus tau) at collocation points;
        force rows over the weight m g, moment rows over the weight times one metre. The base rows of a
        velocity source are its statics, RNEA(q, 0, 0) - sum J^T f.
    contact_acceleration: classical acceleration of active contacts at collocation points over g
        (angular rows of soles in rad/s^2 over g per metre); of a velocity source their velocity at points
        over sqrt(g 1 m).
    friction_margin: least mu f_n - |f_t| at collocation points, ``..._between`` at other samples.
    unilateral_margin: least f_n. sole_margin: least distance of moments from the sole's limits. Each on
        the contact's own surface; none of them on a bilateral one. sliding_friction: largest difference
        between the force of a sliding contact and the law of `trajopt.terms.sliding` at its points. Of
        such contacts contact_acceleration, contact_velocity and foot_drift are those along the normal.
    effort_excess, velocity_excess: largest |x| / limit - 1; negative is reserve.
    drive_torque_excess: largest |tau_m| / torque_limit - 1 of the drives, with joint friction.
    drive_voltage_excess: largest |tau_m / stall_torque + omega_m / no_load_speed| - 1.
    position_excess: largest part of the joint's range beyond its limit; negative is reserve.
    impact_residual: M (v+ - v-) - J^T Lambda over mass times sqrt(g 1 m) (moments: times 1 m),
        impact_velocity: J v+ over sqrt(g 1 m), impact_friction_margin: least mu Lambda_n - |Lambda_t|,
        impact_momentum_error: change of linear and angular momentum minus the impulses (floating bases),
        impact_energy_gain: largest change of kinetic energy, negative where all impacts lose; see
        `impact_figures`. state_jump: largest jump of q or v where intervals meet without an impact.
    penetration, quaternion_error, contact_velocity, foot_drift, foot_turn, sole_tilt: at all samples.
        penetration is below the surface of an active contact, below the terrain otherwise.
        On ground that is no plane it is below the tangent plane of the highest ground under the contact.
    obstacle_distance, self_distance: of capsules around links, by Coal, at samples and between.
    landing_height: distance of active contacts from their surface at their phase's start, unsigned.
    patch_margin: least distance of active contacts (of soles: their corners) inside their patches' edges.
    position_gap, velocity_gap: see `consistency.interval_gaps`. ballistic_error, momentum_error: at
        nodes, ``..._between`` at collocation points, see
        `flight.flight_errors`. open_loop_...: see `reintegration.open_loop`; inf where it diverged.
    """

    base_residual: float | None
    actuated_residual: float | None
    contact_acceleration: float | None
    contact_velocity: float | None
    friction_margin: float | None
    friction_margin_between: float | None
    unilateral_margin: float | None
    sole_margin: float | None
    sliding_friction: float | None
    inactive_force: float | None
    effort_excess: float | None
    effort_excess_between: float | None
    drive_torque_excess: float | None
    drive_voltage_excess: float | None
    drive_voltage_excess_between: float | None
    velocity_excess: float | None
    position_excess: float | None
    penetration: float | None
    obstacle_distance: float | None
    self_distance: float | None
    landing_height: float | None
    patch_margin: float | None
    foot_drift: float | None
    stance_drift: float | None
    foot_turn: float | None
    sole_tilt: float | None
    impact_residual: float | None
    impact_velocity: float | None
    impact_friction_margin: float | None
    impact_momentum_error: float | None
    impact_energy_gain: float | None
    state_jump: float | None
    periodicity_error: float | None
    quaternion_error: float | None
    gimbal_margin: float | None
    position_gap: float
    velocity_gap: float
    ballistic_error: float | None
    momentum_error: float | None
    ballistic_error_between: float | None
    momentum_error_between: float | None
    open_loop_position: float | None
    open_loop_orientation: float | None
    open_loop_joints: float
    phases: tuple[PhaseReport, ...]

    @property
    def ok(self) -> bool:
        """Within the default tolerances."""
        return self.within()

    def within(self, tolerances: Tolerances | None = None) -> bool:
        """Whether every judged figure is within ``tolerances`` (default: those of `Tolerances`)."""
        return not self.failures(tolerances)

    def failures(self, tolerances: Tolerances | None = None) -> tuple[str, ...]:
        """Names of the figures beyond their tolerance."""
        limits = tolerances or Tolerances()
        return tuple(name for name in FIGURES if self._fails(name, limits))

    def _fails(self, name: str, tolerances: Tolerances) -> bool:
        figure, value = FIGURES[name], getattr(self, name)
        limit = None if figure.tolerance is None else getattr(tolerances, figure.tolerance)
        if limit is None or value is None:
            return False
        if figure.least:
            return not value >= limit
        return not (value >= -limit if figure.margin else value <= limit)

    def to_dict(self, tolerances: Tolerances | None = None) -> dict[str, Any]:
        """JSON-able figures by name, ``ok``, ``failures`` and ``phases``; inf and NaN become null."""
        figures = {name: _finite(getattr(self, name)) for name in FIGURES}
        phases = [{key: _finite(entry) for key, entry in asdict(phase).items()} for phase in self.phases]
        failures = list(self.failures(tolerances))
        return {"ok": not failures, "failures": failures, **figures, "phases": phases}

    def table(self, tolerances: Tolerances | None = None) -> str:
        """Figures one a line with unit, tolerance and verdict, then the phases."""
        limits = tolerances or Tolerances()
        lines = [f"{'':42}{'value':>12}  {'unit':12}{'tolerance':>10}"]
        for name, figure in FIGURES.items():
            value = getattr(self, name)
            limit = None if figure.tolerance is None else getattr(limits, figure.tolerance)
            allowed = "" if limit is None else f"{-limit if figure.margin else limit:10.0e}"
            verdict = "  beyond" if self._fails(name, limits) else ""
            if value is not None:
                lines.append(f"{figure.text:42}{value:12.3e}  {figure.unit:12}{allowed:>10}{verdict}")
        for phase in self.phases:
            lines.append(_phase_line(phase))
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.table()


def _phase_line(phase: PhaseReport) -> str:
    names = ", ".join(phase.contacts) or "no contact"
    errors = [
        (phase.open_loop_position, "m"),
        (phase.open_loop_orientation, "rad"),
        (phase.open_loop_joints, "rad"),
    ]
    found = ", ".join(f"{value:.1e} {unit}" for value, unit in errors if value is not None)
    return f"phase {phase.index} ({phase.start:.3f} to {phase.end:.3f} s, {names}): open loop {found}"


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return list(value) if isinstance(value, tuple) else value
