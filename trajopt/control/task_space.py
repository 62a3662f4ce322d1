"""Task-space inverse dynamics without a plan: torques for given tasks in the measured state."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.control.contact_forces import ActiveContact
from trajopt.control.inverse_dynamics import (
    RELAXED,
    QpSolverName,
    TaskSpaceInverseDynamics,
    TickResult,
)
from trajopt.control.limits import RobotLimits
from trajopt.control.robot_state import RobotState
from trajopt.control.tasks import (
    AngularMomentumTask,
    CenterOfMassTask,
    ContactForceTask,
    FrameTask,
    PostureTask,
    RegularisationTask,
    Task,
)
from trajopt.errors import InputError, shown
from trajopt.robot.contact import Contact
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.robot import Robot

# Weight of the accelerations themselves, which decides what tasks leave open.
SMALL = 1e-8
# The vertical, out of level ground.
UP = np.array([0.0, 0.0, 1.0])


class TaskSpaceController:
    """Torques for tasks, with the units, limits, drives and contacts of the robot.

    Joints stay within their ranges and rates, torques within their limits; contacts stand on level ground.

    Args:
        robot: the robot.
        friction: Coulomb's coefficient at its contacts.
        horizon: time for which joints look ahead to their limits, s; enough to stop within the torques.
        solver: solver of the quadratic programs.

    ``state`` has inertia, frames and centre of mass of the last tick, ``last`` has its result.
    """

    @checked
    def __init__(
        self,
        robot: Robot,
        *,
        friction: NonNegative = 0.7,
        horizon: Positive = 0.1,
        solver: QpSolverName = "piqp",
    ) -> None:
        self.robot, self.friction = robot, friction
        self.last: TickResult | None = None
        self.state = RobotState(robot.model, robot.joint_forces)
        units = NaturalUnits.of(robot.model)
        self._program = TaskSpaceInverseDynamics.of(self.state, robot.actuation, units, solver=solver)
        self._limits = RobotLimits.of(robot, horizon, critical=True)
        self._small = RegularisationTask(weight=SMALL, unit=self._program.acceleration_unit)

    @checked
    def torque(
        self, q: np.ndarray, v: np.ndarray, tasks: Sequence[Task], contacts: Sequence[str] | None = None
    ) -> np.ndarray:
        """Torques (nu,) of the actuators, N m or N.

        Args:
            q: measured configuration (nq,).
            v: measured velocity (nv,).
            tasks: tasks of the tick.
            contacts: names of the standing contacts; default: all, and none for a robot with a fixed base.

        Raises:
            InputError: for a state or a task that is not finite or has the wrong shape, for unknown contacts,
                and if no torques within the limits exist.
        """
        robot = self.robot
        names = [c.name for c in robot.contacts if robot.base != "fixed"] if contacts is None else contacts
        if len(set(names)) < len(names):
            raise InputError(f"contacts are {', '.join(names)}", "allowed: each once")
        for task in tasks:
            require_task(task, robot)
        self.state.update(q, v)
        standing = [standing_contact(robot, robot.contact(name), self.friction) for name in names]
        self.last = self._program.solve(standing, [*tasks, self._small], self._limits.at(q, v))
        if RELAXED[self.last.relaxed] == "everything":
            what = "no torques within the limits hold the robot at this state"
            raise InputError(what, "another state, or other contacts")
        return self.last.torque

    @checked
    def step(self, q: np.ndarray, v: np.ndarray, dt: Positive) -> tuple[np.ndarray, np.ndarray]:
        """The state ``dt`` s later with the acceleration of the last result, by semi-implicit Euler."""
        if self.last is None:
            raise InputError("no torques were asked for yet", "allowed: torque(q, v, tasks), then step")
        v = v + dt * self.last.acceleration
        return np.asarray(pin.integrate(self.robot.model, q, dt * v)), v


def standing_contact(robot: Robot, contact: Contact, friction: float) -> ActiveContact:
    """A contact that stands on level ground with Coulomb's coefficient ``friction``."""
    return ActiveContact(
        number=robot.contacts.index(contact),
        frame=contact.frame,
        dimension=6 if contact.kind == "surface" else 3,
        normal=UP,
        friction=friction,
        half_size=(contact.half_length, contact.half_width),
        lever=contact.radius * UP if contact.rolling else None,
    )


def require_task(task: Task, robot: Robot) -> None:
    """Raise `InputError` for a task of the library with a value that is not finite or has the wrong shape."""
    model, name = robot.model, type(task).__name__
    three, six, rates = (3,), (6,), (model.nv,)
    kinds: dict[type, dict[str, tuple[int, ...] | None]] = {
        CenterOfMassTask: {"position": three, "velocity": three, "acceleration": three},
        AngularMomentumTask: {"momentum": three, "rate": three},
        FrameTask: {"velocity": six, "acceleration": six},
        PostureTask: {"q": (model.nq,), "v": rates, "a": rates},
        ContactForceTask: {"wanted": None},  # one row for each contact: `ContactForceTask.rows` checks it
    }
    for key, shape in kinds.get(type(task), {}).items():
        value = getattr(task, key)
        if value is None:
            continue
        if np.shape(value) != (shape or np.shape(value)) or not np.isfinite(value).all():
            what = f"of shape {shape}" if shape else "numbers"
            raise InputError(f"{key} of {name} is {shown(value)}", f"allowed: finite, {what}")
    if isinstance(task, ContactForceTask) and not robot.contacts:
        raise InputError(f"robot '{robot.name}' has no contact, which {name} needs")
    if isinstance(task, FrameTask) and not isinstance(task.pose, pin.SE3):
        raise InputError(f"pose of {name} is {shown(task.pose)}", "allowed: pinocchio.SE3")
    if not 0 <= task.weight < np.inf:
        raise InputError(f"weight of {name} is {task.weight}", "allowed: 0 and more")
    if not 0 < getattr(task, "bandwidth", 1.0) < np.inf:
        raise InputError(f"bandwidth of {name} is {shown(getattr(task, 'bandwidth', None))}", "above 0, 1/s")
