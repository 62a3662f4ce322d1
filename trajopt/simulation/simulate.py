"""Simulation of a plan in MuJoCo, in one call."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.control.gains import TrackerGains
from trajopt.control.reference import ContactTimeline, ReferenceTrajectory, reference_of
from trajopt.control.tracker import Tracker
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.errors import InputError, not_among
from trajopt.motion.description import TORQUE_INPUTS
from trajopt.motion.input import SolutionOrFile, require_motion, solution_of
from trajopt.motion.solution import Solution
from trajopt.robot.mujoco_package import muted_mujoco
from trajopt.simulation import figures
from trajopt.simulation.joint_feedback import JointFeedback, PlanFeedback
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.report import ContactReport, SimulationReport, TickReport
from trajopt.simulation.run import SimulationRun, Start
from trajopt.simulation.scene import Scene, build_scene
from trajopt.simulation.settings import FEEDBACK_TIME, GivenController, SimulationSettings, TorqueController
from trajopt.simulation.simulated import SimulatedMotion
from trajopt.simulation.site import Site


@dataclass(frozen=True, kw_only=True)
class Simulation(SimulatedMotion):
    """A simulated plan. timeline: the plan at the ticks. wall_time: of the physics, s."""

    plan: Solution
    timeline: ReferenceTrajectory
    report: SimulationReport
    wall_time: float


@checked
def simulate(solution: SolutionOrFile, **settings: Any) -> Simulation:
    """Simulate a plan in MuJoCo under a feedback controller.

    Args:
        solution: the plan, or the path of its file.
        settings: fields of `SimulationSettings`.

    Raises:
        InputError: for settings or a model that cannot be simulated, or if MuJoCo is not installed.
    """
    plan = require_motion(solution_of(solution))
    known = [field.name for field in fields(SimulationSettings)]
    unknown = ", ".join(sorted(set(settings) - set(known)))
    if unknown:
        raise InputError(f"a simulation has no setting {unknown}", f"allowed: {', '.join(known)}")
    wanted = SimulationSettings(**settings)
    require_fitting(wanted, plan.model, plan.contact_frames)
    if wanted.rolling is not None and not plan.description.radii.any():
        raise InputError(
            f"rolling has no effect on '{plan.description.robot}'", "allowed: for contacts with a radius"
        )
    if wanted.friction_scale != 1 and not (plan.contact_frames or plan.description.obstacles):
        what = f"friction_scale has no effect on '{plan.description.robot}', which touches nothing"
        raise InputError(what, "allowed: for motions with contacts or obstacles")
    with muted_mujoco():
        reference = reference_of(plan, wanted.control_rate, wanted.cycles)
        require_within(wanted, reference)
        scene = build_scene(Site.of_plan(plan), wanted)
        begin = time.perf_counter()
        record = plan_run(scene, reference, wanted).record()
        spent = time.perf_counter() - begin
    return Simulation(
        plan=plan,
        settings=wanted,
        timeline=reference,
        scene=scene,
        record=record,
        report=_report(reference, record, scene),
        wall_time=spent,
    )


def plan_run(scene: Scene, reference: ReferenceTrajectory, settings: SimulationSettings) -> SimulationRun:
    """The run of a plan from its start, under the controller of the settings. Raises `InputError`."""
    controller = _controller(scene, reference, settings)
    start = Start(q=reference.q[0], v=reference.v[0], torque=reference.drive_torque[0])
    return SimulationRun(scene, reference, controller, start, settings)


def _controller(
    scene: Scene, reference: ReferenceTrajectory, settings: SimulationSettings
) -> TorqueController:
    given = settings.controller
    if given == "joints":
        return JointFeedback(scene, reference, settings)
    if given == "gains":
        return PlanFeedback(scene, reference, settings)
    if given == "whole-body":
        gains = settings.gains or TrackerGains()
        return Tracker.of_reference(reference, settings.control_rate, gains, settings.qp_solver)
    if not isinstance(given, Tracker):
        return GivenController(given, scene.robot.nu)
    ticks = len(given.reference.t), given.reference.period
    if ticks != (len(reference.t), reference.period) or given.reference.model != reference.model:
        raise InputError(
            "the Tracker of a simulation is of another plan, or has other ticks",
            f"allowed: one of this plan, rate={settings.control_rate:g}, cycles={settings.cycles}",
        )
    return given


def require_fitting(settings: SimulationSettings, model: pin.Model, frames: Sequence[str]) -> None:
    """Raise `InputError` for settings that do not fit a robot with these contact ``frames``."""
    kind = base_of(model)
    if settings.push and kind == "fixed":
        raise InputError(
            f"push of {settings.push:g} N on the base, which is fixed", "allowed: 0 N for an arm"
        )
    if settings.impulses and kind == "fixed":
        raise InputError("an impulse on the base, which is fixed", "allowed: none for an arm")
    if any(settings.com_offset) and kind == "fixed":
        raise InputError("com_offset of a robot whose base is fixed", "allowed: none for an arm")
    if settings.com_offset[1] and kind == "planar":
        aside = settings.com_offset[1]
        raise InputError(f"com_offset of {aside:g} m to the side of a robot in a plane", "allowed: x and z")
    if any(settings.com_offset) and not model.inertias[BASE_JOINT[kind]].mass > 0:
        raise InputError("com_offset of a robot whose base has no mass", "allowed: none for it")
    for wrench in settings.wrenches:
        wrench.place(model)
    for name in settings.ground_offsets:
        if name not in frames:
            raise not_among(frames, name, f"ground_offsets of SimulationSettings for '{name}'")


def require_within(settings: SimulationSettings, timeline: ContactTimeline) -> None:
    """Raise `InputError` for an impulse or a wrench that starts after the simulation."""
    last = timeline.period * (len(timeline.t) - 1)
    starts = [("an impulse", impulse.time) for impulse in settings.impulses]
    starts += [(f"a wrench on '{wrench.frame}'", wrench.times[0]) for wrench in settings.wrenches]
    for what, start in starts:
        if not start <= last:
            raise InputError(f"{what} at {start:g} s is after the simulation", f"allowed: 0 to {last:g} s")


def _report(reference: ReferenceTrajectory, record: SimulationRecord, scene: Scene) -> SimulationReport:
    errors = figures.tracking_errors(scene, reference, scene.coordinates.from_mujoco(record.qpos))
    fall = figures.FallTest(scene).first(record, reference, slice(None), reference.q)
    stances = figures.simulated_stances(reference, record, scene)
    moving, end = scene.robot.base != "fixed", min(reference.planned, len(record.feet))
    force = figures.force_error(reference, record)
    return SimulationReport(
        problem=reference.problem,
        robot=reference.robot,
        reach=scene.units.length,
        duration=reference.period * reference.planned,
        held=reference.period * reference.held,
        timestep=float(scene.compiled.opt.timestep),
        feedback_rate=1.0 / (FEEDBACK_TIME * scene.units.time),
        **SimulationReport.of_fall(fall),
        base_error_end=float(errors.base[end]) if moving else None,
        base_error_max=float(errors.base[: end + 1].max()) if moving else None,
        base_error_rms=float(np.sqrt((errors.base[: end + 1] ** 2).mean())) if moving else None,
        base_error_held=float(errors.base[-1]) if moving else None,
        base_turn_end=float(errors.turn[end]) if moving else None,
        base_turn_max=float(errors.turn[: end + 1].max()) if moving else None,
        joint_error_end=float(errors.joint[end]),
        joint_error_max=float(errors.joint[: end + 1].max()),
        joint_error_rms=float(np.sqrt((errors.joints[: end + 1] ** 2).mean())) if errors.joints.size else 0.0,
        saturated=float(record.saturated.mean()) if record.saturated.size else 0.0,
        swing_load=figures.swing_load(reference, record, scene),
        force_error=None if force is None else force / scene.units.weight,
        obstacle_hit=bool(record.hit.any()),
        controller=None if record.counts is None else TickReport.of(record.counts),
        notes=_notes(scene),
        **_contacts(stances, scene),
    )


def _contacts(stances: tuple[figures.SimulatedStance, ...], scene: Scene) -> dict[str, Any]:
    """Fields of the report on contacts."""
    times = [abs(stance.touchdown) for stance in stances if stance.touchdown is not None]
    travel = [stance.travel for stance in stances if stance.travel is not None]
    frames = scene.robot.description.frames
    by_contact = [[stance for stance in stances if stance.contact == i] for i in range(len(frames))]
    return {
        "touchdown_error": max(times, default=None),
        "missed": sum(stance.missed for stance in stances),
        "slips": sum(way > figures.SLIP * scene.units.length for way in travel),
        "slip_travel": max(travel, default=None),
        "contacts": tuple(
            ContactReport(
                frame=frame,
                touchdowns=tuple(s.touchdown for s in rows if s.touchdown is not None),
                missed=sum(s.missed for s in rows),
                travel=max((s.travel for s in rows if s.travel is not None), default=None),
            )
            for frame, rows in zip(frames, by_contact, strict=True)
        ),
    }


def _notes(scene: Scene) -> tuple[str, ...]:
    """Notes on what the plan prescribes or idealises in the simulation."""
    about, notes = scene.robot.description, []
    for grasp in scene.site.grasps:
        phases = about.phase_names[grasp.phases[0] : grasp.phases[-1] + 1]
        notes.append(f"{about.frames[grasp.contact]} is held as planned in {', '.join(phases)}")
    for name, depth in scene.site.buried.items() if scene.robot.base != "fixed" else ():
        notes.append(f"the plan takes {name} {1e3 * max(depth, 0.0):.0f} mm into the ground")
    if about.payloads:
        notes.append("what is carried is part of the link that holds it while the plan carries it")
    if about.actuation not in TORQUE_INPUTS:
        notes.append(f"actuation by {about.actuation}: the drives have no torque limits here")
    return tuple(notes)
