"""Replanning of a finite motion, such as a jump: its remainder is planned again and again as the robot moves.

The plan provides the contact modes, the reference of base, joints and feet, and the heights of landings. If
contacts land early, their mode ends and the next one is longer: the reference keeps the time of the plan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
import pinocchio as pin

from trajopt.arguments import PositiveCount, checked
from trajopt.control.mpc.clock import Mode, ModeClock
from trajopt.control.mpc.planner import PlannerSettings
from trajopt.control.mpc.receding import ControllerSettings, LegsController
from trajopt.control.mpc.reference import HorizonWeights, Reference, reference_layout
from trajopt.control.reference import ReferenceTrajectory, reference_of
from trajopt.dynamics.model_quantities import mass_of
from trajopt.errors import InputError
from trajopt.motion.description import TORQUE_INPUTS
from trajopt.motion.samples import contact_places
from trajopt.motion.solution import Solution
from trajopt.motion.touched import touched_surfaces
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units

# Rate at which the plan is sampled, Hz.
RATE = 1000.0
# Cycles of a periodic plan after the last one, for horizons to look ahead.
LOOKAHEAD_CYCLES = 2
# Period of the horizons of finite motions, over sqrt(l / g).
PERIOD = 2.6
# Ground is level if the vertical part of its normal is above 1 minus this.
LEVEL = 1e-6
# Relative difference up to which masses are the same.
SAME = 1e-9
# Weights of the cost with which a plan is followed.
WEIGHTS = HorizonWeights(position=20.0, velocity=5.0, rise=5.0, joints=1.0, rates=0.0, feet=20.0)
USUAL = ControllerSettings(planner=PlannerSettings(span=1.0, timing=0.0, weights=WEIGHTS))


class PlanClock(ModeClock):
    """The modes of a plan, after which the contacts of the last one stand for ever.

    Args:
        contacts: names of all feet.
        modes: modes of the plan.
        period: natural duration of a step, s.
    """

    keeps_time = True

    def __init__(self, contacts: tuple[str, ...], modes: list[Mode], period: float) -> None:
        super().__init__(contacts, modes, [Mode(modes[-1].contacts, math.inf)], period)
        self._ends = [0.0, *np.cumsum([mode.duration for mode in modes]).tolist()]

    @property
    def time(self) -> float:
        """Present time in the plan, s; after the plan, its end."""
        left = len(self._queue) if math.isfinite(self.remaining) else 0
        return float(self._ends[-left] - self.remaining) if left else self._ends[-1]


class ReplanningController(LegsController[PlanClock]):
    """Follows a plan by replanning it from the measured state; a controller for `simulate`.

    Args:
        robot: a robot with a free base.
        plan: a plan of this robot on level surfaces, at any heights.
        settings: settings of the plans and of the feedback; default: `USUAL` with the friction of the plan.
        cycles: number of cycles of a periodic plan.

    Raises:
        InputError: if the base is not free, the ground is not level, contacts hold on or slide, inputs are
            not torques of all joints, the plan has payloads or no contacts, or it is of another robot.
    """

    @checked
    def __init__(
        self,
        robot: Robot,
        plan: Solution,
        settings: ControllerSettings | None = None,
        *,
        cycles: PositiveCount = 1,
    ) -> None:
        _require_fitting(robot, plan)
        repeats = plan.description.periodicity is not None
        trajectory = reference_of(plan, RATE, cycles + LOOKAHEAD_CYCLES if repeats else cycles)
        names = {contact.frame: contact.name for contact in robot.contacts}
        self.plan, contacts = plan, [names[frame] for frame in plan.contact_frames]
        modes = _modes(trajectory, contacts)
        clock = PlanClock(tuple(contacts), modes, PERIOD * Units(robot).time)
        friction = min(contact.friction for contact in plan.description.contacts)
        super().__init__(robot, clock, settings or replace(USUAL, friction=friction))
        self._rows, self._period = _reference_rows(robot, trajectory), trajectory.period
        self._order = [
            contacts.index(contact.name) if contact.name in contacts else -1 for contact in robot.contacts
        ]

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) at ``t`` s, see `TorqueController`; ``touching`` (nc,) is in the plan's order."""
        count = len(self.plan.contact_frames)
        if np.shape(touching) != (count,):
            raise InputError(
                f"contacts have shape {np.shape(touching)}", f"allowed: ({count},), those of the plan"
            )
        passed = self._passed(t, q, v, np.append(touching, False)[self._order])
        return self._follow(passed, q, v, lambda: self._reference_at)

    def _reference_at(self, clock: PlanClock, base: np.ndarray) -> Reference:
        return PlanReference(robot=self.robot, rows_of_plan=self._rows, period=self._period, time=clock.time)


@dataclass(frozen=True, kw_only=True)
class PlanReference:
    """The plan from its time ``time`` s on; ``rows_of_plan`` (n, size) has a row for each ``period`` s."""

    robot: Robot
    rows_of_plan: np.ndarray
    period: float
    time: float

    def rows(self, times: np.ndarray) -> np.ndarray:
        """The reference (n, size) at times (n,) from now, s; after the plan it is at rest."""
        at, last = reference_layout(self.robot), len(self.rows_of_plan) - 1
        place = np.rint((self.time + times) / self.period).astype(int)
        rows = self.rows_of_plan[np.minimum(place, last)]
        rows[place > last, at.velocity.start : at.spin.stop] = 0.0
        return rows

    def landing_height(self, name: str, time: float) -> float:
        """Height of a contact's frame ``time`` s from now, m."""
        at = reference_layout(self.robot)
        number = self.robot.contacts.index(self.robot.contact(name))
        return float(self.rows(np.array([time]))[0, at.foot(number).start + 2])


def _require_fitting(robot: Robot, plan: Solution) -> None:
    """Raise `InputError` for a plan that cannot be replanned, or is of another robot."""
    if robot.base != "freeflyer":
        raise InputError(f"robot '{robot.name}' has a {robot.base} base", "allowed: a free one")
    about, what = plan.description, f"the plan of '{plan.description.problem}' cannot be replanned"
    if (
        about.actuation not in TORQUE_INPUTS
        or about.payloads
        or about.wrenches
        or not plan.active.any()
        or robot.nu < robot.nv - 6
    ):
        raise InputError(what, "allowed: torques at all joints, contacts, and no payloads or known wrenches")
    masses = [mass_of(model) for model in (plan.model, robot.model)]
    same = list(plan.model.names) == list(robot.model.names) and math.isclose(*masses, rel_tol=SAME)
    if not same or not set(plan.contact_frames) <= {contact.frame for contact in robot.contacts}:
        raise InputError(
            f"the plan of '{about.robot}' has other joints, contacts or another mass than '{robot.name}'",
            "allowed: the robot of the plan",
        )
    touched = touched_surfaces(about, contact_places(plan).position, plan.phase)
    steep, held = touched.normal[:, :, 2] < 1.0 - LEVEL, touched.bilateral | touched.slides
    for kind, wrong in (("steep ground", steep), ("what they hold or slide along", held)):
        if (wrong & plan.active).any():
            raise InputError(f"{what}: contacts are on {kind}", "allowed: level ground, at any heights")


def _modes(trajectory: ReferenceTrajectory, contacts: list[str]) -> list[Mode]:
    """The modes of a plan: intervals with constant contacts."""
    return [
        Mode(tuple(compress(contacts, trajectory.active[begin])), (end - begin) * trajectory.period)
        for begin, end in trajectory.modes
    ]


def _reference_rows(robot: Robot, trajectory: ReferenceTrajectory) -> np.ndarray:
    """The reference (n, size) at the samples of a plan: base, joints and feet."""
    at = reference_layout(robot)
    rows = np.zeros((len(trajectory.t), at.size))
    rows[:, at.position], rows[:, at.quaternion] = trajectory.q[:, :3], trajectory.q[:, 3:7]
    rows[:, at.spin], rows[:, at.posture] = trajectory.v[:, 3:6], trajectory.q[:, 7:]
    for row, q, v in zip(rows, trajectory.q, trajectory.v, strict=True):
        row[at.velocity] = pin.XYZQUATToSE3(q[:7]).rotation @ v[:3]
        for number, place in enumerate(contact_positions(robot, q).values()):
            row[at.foot(number)] = np.append(place, np.ones(3))
    return rows
