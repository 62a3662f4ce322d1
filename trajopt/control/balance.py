"""Balance: the support of a robot at a tick, and the task by which its centre of mass follows the plan."""

import numpy as np

from trajopt.control.contact_forces import cross
from trajopt.control.gains import TrackerGains
from trajopt.control.plan_targets import PlanTargets
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.robot_state import RobotState
from trajopt.control.support import LOWEST, Support, next_narrow, support_of, thin_axes
from trajopt.control.tasks import CenterOfMassTask
from trajopt.robot.natural_units import NaturalUnits
from trajopt.solution.solution import Solution

# Largest feedback acceleration of the centre of mass, over g: more would only leave the friction cones.
MOST_FEEDBACK = 1.0
# Shortest stance on a line or a point in which the robot actively balances, over sqrt(l / g).
LASTING = 1.0
# Width, over l, below which a support is a line or a point, on which only motion can balance.
THIN = 1e-2


class Balance:
    """Supports at the ticks of a plan, and the centre of mass over them.

    Args:
        plan: the tracked plan.
        reference: the plan at the ticks.
        targets: targets of the plan at the ticks.
        gains: gains of the feedback.

    ``wide`` (n,) tells whether the planned contacts hold the body in all directions: by a sole, a held
    contact, or points that are not on a line. ``lasts`` (n,): whether the robot balances on narrow ones.
    """

    def __init__(
        self, plan: Solution, reference: ReferenceTrajectory, targets: PlanTargets, gains: TrackerGains
    ) -> None:
        self._units, self._gains, self._targets = NaturalUnits.of(plan.model), gains, targets
        self._frames = [plan.model.getFrameId(name) for name in plan.contact_frames]
        self._walks = bool(plan.description.periodicity)
        self.wide = np.array([self._is_wide(plan, row, k) for k, row in enumerate(reference.active)])
        self.lasts = self._lasting(reference)
        # In gaits feet land where they catch the centre of mass instead.
        self._next = next_narrow(reference.active, self.wide) & (not self._walks)

    def support(self, k: int, standing: np.ndarray, state: RobotState) -> Support:
        """The support at tick k; it is narrow only if the planned one is, not because a foot is late."""
        picked = np.flatnonzero(standing)
        places = np.array([state.frame(self._frames[i]).placement.translation for i in picked])
        return support_of(
            places,
            self._targets.position[k, picked],
            np.zeros((0, 3)) if self.wide[k] else thin_axes(places, THIN * self._units.length),
            state.centre_of_mass()[0],
            self._units.gravity,
            LOWEST * self._units.length,
        )

    def task(self, k: int, support: Support, state: RobotState) -> CenterOfMassTask:
        """The task by which the centre of mass follows the plan, as far as the support allows.

        On a narrow support that lasts, the angular momentum follows the plan too. If the support p has no
        extent along u, only gravity changes the angular momentum L about its line, whose level part is z x u:
        dL = m g (c - p) u. A triple pole of this chain of integrators (Azad and Featherstone, IEEE Trans.
        Robotics 32, 2016) gives, with errors e and the bandwidth w,
            dd c = dd c_d - 3 w de - 3 w^2 e - w^3 e_L / (m g)
        On a narrow support that does not last, the centre of mass falls like a pendulum until the next feet
        stand. Before that, on the wide support, it follows the feet that will carry it, which may stand
        beside their planned places.
        """
        gains, units, targets = self._gains, self._units, self._targets
        w, tilt = gains.body / units.time, gains.balance / units.time
        position, velocity, _, _ = state.centre_of_mass()
        wanted, rate, acceleration = targets.com[k]
        error, change = position - wanted, velocity - rate
        if self._next[k].any():
            error -= self.support(k, self._next[k], state).offset
        feedback = -2 * w * change - w**2 * error
        across = support.axes.T @ support.axes
        if len(support.axes) and self.lasts[k]:
            mass = units.weight / units.gravity
            here, planned = support.places.mean(axis=0), support.planned.mean(axis=0)
            momentum = state.angular_momentum()[0] + mass * cross(position - here, velocity)
            asked = targets.momentum[k] + mass * cross(wanted - planned, rate)
            turned = support.axes.T @ (support.lines @ (momentum - asked)) / units.weight
            poles = 3 * tilt * change + 3 * tilt**2 * (error - support.offset)
            feedback -= across @ (poles + feedback) + tilt**3 * turned
        elif len(support.axes):
            feedback += across @ (support.falling(error) - feedback)
            feedback = support.reachable(position, acceleration + feedback) - acceleration
        most = MOST_FEEDBACK * units.gravity
        feedback *= min(1.0, most / max(float(np.linalg.norm(feedback)), most))
        return CenterOfMassTask(
            weight=gains.thin_com_weight if len(support.axes) and not self._walks else gains.com_weight,
            position=position,
            velocity=velocity,
            acceleration=acceleration + feedback,
            bandwidth=0.0,
            unit=units.gravity,
        )

    def _is_wide(self, plan: Solution, active: np.ndarray, k: int) -> bool:
        picked = np.flatnonzero(active)
        if plan.description.soles[picked].any() or self._targets.surfaces.bilateral[k, picked].any():
            return True
        return len(picked) > 2 and not len(
            thin_axes(self._targets.position[k, picked], THIN * self._units.length)
        )

    def _lasting(self, reference: ReferenceTrajectory) -> np.ndarray:
        """Ticks (n,) of lasting stances on one line or point; in shorter ones the robot does not balance."""
        active = reference.active
        lasting = np.zeros(len(active), dtype=bool)
        if self._walks or self.wide[active.any(axis=1)].any():
            return lasting  # the next steps, or a wider support, balance the robot
        for begin, end in reference.modes:
            lasts = (end - begin) * reference.period >= LASTING * self._units.time
            lasting[begin:end] = lasts and bool(active[begin].any()) and not self.wide[begin]
        return lasting
