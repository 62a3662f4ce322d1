"""Programs of one tick against closed forms: statics, inverse dynamics, limits, priorities, cones."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from trajopt.control import (
    CenterOfMassTask,
    ContactForceTask,
    FrameTask,
    PostureTask,
    RobotState,
    Task,
    TaskSpaceInverseDynamics,
    TickLimits,
    TickResult,
)
from trajopt.control.contact_forces import ActiveContact
from trajopt.control.inverse_dynamics import RELAXED
from trajopt.errors import InputError
from trajopt.robot.natural_units import NaturalUnits, turning_rows
from trajopt.robot.robot import Robot
from trajopt_library import robots

UP = np.array([0.0, 0.0, 1.0])
# Of programs over natural units, with a margin: their accuracy is 1e-4.
SOLVED = 2e-3
SOLVERS = ["osqp", "piqp", "proxqp"]


class Standing:
    """A robot on its feet in its reference posture."""

    def __init__(self, name: str, solver: str = "osqp", friction: float = 0.7) -> None:
        self.robot: Robot = robots.load(name)
        model, self.units = self.robot.model, NaturalUnits.of(self.robot.model)
        self.state = RobotState(model)
        self.rest = np.zeros(model.nv)
        self.state.update(self.robot.reference, self.rest)
        turning, length, weight = turning_rows(model), self.units.length, self.units.weight
        self.acceleration = np.where(turning, self.units.gravity / length, self.units.gravity)
        self.programs = TaskSpaceInverseDynamics(
            state=self.state,
            actuation=self.robot.actuation,
            acceleration_unit=self.acceleration,
            force_units=(weight, weight * length),
            torque_unit=np.where(turning, weight * length, weight),
            damping=0.0,
            solver=solver,  # type: ignore[arg-type]
        )
        places = {c.name: self.state.frame(model.getFrameId(c.frame)).placement for c in self.robot.contacts}
        lowest = min((place.translation[2] for place in places.values()), default=0.0)
        self.contacts = [
            ActiveContact(
                number=i,
                frame=model.getFrameId(c.frame),
                dimension=3 if c.kind == "point" else 6,
                normal=UP,
                friction=friction,
                half_size=(c.half_length, c.half_width),
            )
            for i, c in enumerate(self.robot.contacts)
            if places[c.name].translation[2] < lowest + 0.02
        ]

    def limits(self, torque: float = np.inf, acceleration: float = np.inf) -> TickLimits:
        size = self.robot.nv - self.robot.n_unactuated
        torques, accelerations = np.full(size, torque), np.full(size, acceleration)
        return TickLimits(
            torque=(-torques, torques), acceleration=(-accelerations, accelerations), friction=np.zeros(size)
        )

    def posture(self, a: np.ndarray | None = None, **settings: float) -> PostureTask:
        rows = np.arange(self.robot.n_unactuated, self.robot.nv)
        return PostureTask(
            q=self.state.q,
            v=self.rest,
            a=self.rest if a is None else a,
            bandwidth=0.0,
            rows_of_v=rows,
            weights=np.ones(len(rows)),
            unit=self.acceleration[rows],
            **settings,  # type: ignore[arg-type]
        )

    def body(self, acceleration: np.ndarray, **settings: float) -> CenterOfMassTask:
        position, velocity, _, _ = self.state.centre_of_mass()
        return CenterOfMassTask(
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            bandwidth=0.0,
            unit=self.units.gravity,
            **settings,  # type: ignore[arg-type]
        )

    def forces(self, wanted: np.ndarray | None = None) -> ContactForceTask:
        given = np.zeros((len(self.robot.contacts), 6)) if wanted is None else wanted
        units = self.units.weight, self.units.weight * self.units.length
        return ContactForceTask(wanted=given, units=units, weight=1e-3)

    def solve(self, tasks: list[Task], limits: TickLimits | None = None) -> TickResult:
        return self.programs.solve(self.contacts, tasks, limits or self.limits())

    def residual(self, found: TickResult) -> np.ndarray:
        """M a + h - J' f - S' tau (nv,) by Pinocchio's own algorithms."""
        model, data = self.robot.model, self.robot.model.createData()
        whole = pin.rnea(model, data, self.state.q, self.state.v, found.acceleration).copy()
        for contact, force in zip(self.contacts, found.forces, strict=True):
            jacobian = pin.computeFrameJacobian(
                model, data, self.state.q, contact.frame, pin.LOCAL_WORLD_ALIGNED
            )
            whole -= jacobian[: contact.dimension].T @ force[: contact.dimension]
        whole[self.robot.n_unactuated :] -= found.torque
        return whole


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("name", ["go2", "solo12", "talos", "g1"])
def test_a_standing_robot_carries_its_weight(name: str, solver: str) -> None:
    case = Standing(name, solver)
    found = case.solve([case.posture(), case.body(np.zeros(3)), case.forces()])
    assert RELAXED[found.relaxed] == "nothing"
    assert_allclose(found.forces[:, :3].sum(axis=0), case.units.weight * UP, atol=SOLVED * case.units.weight)
    assert_allclose(found.acceleration / case.acceleration, 0.0, atol=SOLVED)
    model = case.robot.model
    centre = pin.centerOfMass(model, model.createData(), case.state.q)
    places = np.array([case.state.frame(c.frame).placement.translation for c in case.contacts])
    moment = np.cross(places - centre, found.forces[:, :3]).sum(axis=0) + found.forces[:, 3:].sum(axis=0)
    assert_allclose(moment, 0.0, atol=SOLVED * case.units.weight * case.units.length)


@pytest.mark.parametrize("solver", SOLVERS)
def test_where_nothing_binds_torques_are_inverse_dynamics(solver: str) -> None:
    case = Standing("go2", solver)
    found = case.solve([case.posture(weight=1e-6), case.body(np.array([0.5, 0.2, 1.0])), case.forces()])
    unit = case.programs.torque_unit
    assert_allclose(case.residual(found) / unit, 0.0, atol=SOLVED)
    jacobian = case.state.centre_of_mass()[2]
    assert_allclose(jacobian @ found.acceleration, [0.5, 0.2, 1.0], atol=1e-2)
    for contact in case.contacts:  # feet stand
        assert_allclose(case.state.frame(contact.frame).jacobian[:3] @ found.acceleration, 0.0, atol=1e-2)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_torque_limit_that_binds_is_kept(solver: str) -> None:
    case = Standing("go2", solver)
    tasks: list[Task] = [case.posture(weight=1e-4), case.body(np.array([0.0, 0.0, 8.0])), case.forces()]
    limit = 0.7 * float(np.abs(case.solve(tasks).torque).max())
    found = case.solve(tasks, case.limits(torque=limit))
    assert np.abs(found.torque).max() <= limit
    assert np.abs(found.torque).max() == pytest.approx(limit, rel=1e-3)
    unit = case.programs.torque_unit
    assert_allclose(case.residual(found) / unit, 0.0, atol=10 * SOLVED)  # before they were clipped, too


@pytest.mark.parametrize("name", ["go2", "talos"])
def test_forces_stay_in_coulombs_cone_and_soles_on_their_rectangles(name: str) -> None:
    case = Standing(name, friction=0.3)
    found = case.solve([case.posture(weight=1e-4), case.body(np.array([6.0, 0.0, 0.0])), case.forces()])
    for contact, force in zip(case.contacts, found.forces, strict=True):
        assert force[2] >= -SOLVED * case.units.weight
        assert np.hypot(*force[:2]) <= 0.3 * force[2] + SOLVED * case.units.weight
        if contact.dimension == 6 and force[2] > 0:
            rotation = case.state.frame(contact.frame).placement.rotation
            x, y = rotation.T @ force[3:] @ np.eye(3)[:, [0, 1]]
            slack = SOLVED * case.units.weight * case.units.length
            assert abs(y) <= contact.half_size[0] * force[2] + slack
            assert abs(x) <= contact.half_size[1] * force[2] + slack
    used = max(np.hypot(*f[:2]) / (0.3 * f[2]) for f in found.forces if f[2] > 0.01 * case.units.weight)
    assert used > 0.9  # the cone, not something else, holds it back


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_second_priority_acts_in_what_the_first_leaves_free(solver: str) -> None:
    case = Standing("go2", solver)
    lift = np.array([0.0, 0.0, 1.0])
    turned = case.rest.copy()
    turned[case.robot.n_unactuated :] = 3.0 * (-1.0) ** np.arange(case.robot.nv - case.robot.n_unactuated)
    alone = case.solve([case.body(lift), case.forces()])
    both = case.solve([case.body(lift), case.forces(), case.posture(turned, priority=2, weight=1e3)])
    jacobian = case.state.centre_of_mass()[2]
    assert_allclose(jacobian @ both.acceleration, jacobian @ alone.acceleration, atol=1e-2)
    assert_allclose(jacobian @ both.acceleration, lift, atol=1e-2)
    weighed = case.solve([case.body(lift), case.forces(), case.posture(turned, weight=1e3)])
    assert np.abs(jacobian @ weighed.acceleration - lift).max() > 0.1  # with weights alone it gives way


def test_priorities_are_null_space_projections_where_nothing_binds() -> None:
    case = Standing("ur5")
    case.contacts = []
    state, nv = case.state, case.robot.nv
    frame = case.robot.model.getFrameId("tool0")
    wanted = np.array([0.3, -0.2, 0.4])
    first = FrameTask(
        frame=frame,
        pose=state.frame(frame).placement,
        velocity=np.zeros(6),
        acceleration=np.concatenate([wanted, np.zeros(3)]),
        bandwidth=0.0,
        selection=np.eye(6)[:3],
    )
    second = np.linspace(-1.0, 1.0, nv)
    found = case.solve([first, replace(case.posture(second), priority=2)])
    jacobian = state.frame(frame).jacobian[:3]
    scale = np.diag(case.acceleration)
    inverse = scale @ np.linalg.pinv(jacobian @ scale)  # least in the posture's own units
    projected = inverse @ wanted + (np.eye(nv) - inverse @ jacobian) @ second
    assert_allclose(found.acceleration / case.acceleration, projected / case.acceleration, atol=1e-3)


def test_rows_are_relaxed_in_their_order_and_said_so() -> None:
    case = Standing("go2")
    push = case.body(np.array([0.0, 0.0, 4.0]))
    stuck = case.limits(acceleration=1e-6)  # joints that may not move while the body has to
    low, high = stuck.acceleration
    forced = replace(stuck, acceleration=(low + 5.0, high + 5.0))
    found = case.solve([case.posture(), push, case.forces()], forced)
    assert RELAXED[found.relaxed] == "joint limits"
    assert np.isfinite(found.torque).all()
    none = replace(case.limits(), torque=(np.full(12, 50.0), np.full(12, 60.0)))
    assert RELAXED[case.solve([case.posture(), push, case.forces()], none).relaxed] == "contacts"


def test_slack_is_the_largest_violation_of_what_was_relaxed() -> None:
    case = Standing("go2")
    first, tasks = case.robot.n_unactuated, [case.posture(), case.forces()]
    assert case.solve(tasks).slack == 0.0
    forced = 5.0  # rad/s^2 of every joint, which feet that stand do not let all of them have
    exact = replace(case.limits(), acceleration=(np.full(12, forced), np.full(12, forced)))
    found = case.solve(tasks, exact)
    apart = np.abs(found.acceleration[first:] - forced) / case.acceleration[first:]
    assert RELAXED[found.relaxed] == "joint limits"
    assert found.slack == pytest.approx(apart.max())
    lifted = replace(case.limits(), torque=(np.full(12, 50.0), np.full(12, 60.0)))
    found = case.solve(tasks, lifted)
    feet = [case.state.frame(contact.frame) for contact in case.contacts]
    moved = max(float(np.abs(foot.jacobian[:3] @ found.acceleration).max()) for foot in feet)
    assert RELAXED[found.relaxed] == "contacts"
    assert found.slack == pytest.approx(moved / case.units.gravity)
    assert found.slack > 0.1


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_program_without_solution_gives_no_torque_and_no_exception(solver: str) -> None:
    case = Standing("go2", solver)
    nothing = replace(case.limits(), torque=(np.full(12, 10.0), np.full(12, -10.0)))
    found = case.solve([case.posture(), case.forces()], nothing)
    assert RELAXED[found.relaxed] == "everything"
    assert np.isfinite(found.torque).all()


def test_solvers_agree() -> None:
    found = {}
    for solver in SOLVERS:
        case = Standing("talos", solver)
        tasks: list[Task] = [case.posture(weight=1e-2), case.body(np.array([0.3, 0.1, 0.5])), case.forces()]
        found[solver] = case.solve(tasks).torque / case.programs.torque_unit[case.robot.n_unactuated :]
    assert_allclose(found["osqp"], found["piqp"], atol=10 * SOLVED)
    assert_allclose(found["proxqp"], found["piqp"], atol=SOLVED)


def test_unknown_solvers_and_goals_that_are_none_are_refused() -> None:
    case = Standing("go2", "osqpp")
    with pytest.raises(InputError, match="solver of quadratic programs is 'osqpp'; did you mean osqp"):
        case.solve([case.posture()])
    case = Standing("go2")
    with pytest.raises(InputError, match="CenterOfMassTask asks for what is not finite"):
        case.solve([case.body(np.array([np.nan, 0.0, 0.0]))])


def test_a_sliding_contact_transmits_friction_against_its_way() -> None:
    case = Standing("go2")
    along = np.array([1.0, 0.0, 0.0])
    case.contacts = [replace(contact, sliding=along) for contact in case.contacts]
    found = case.solve([case.posture(), case.forces()])
    assert_allclose(found.forces[:, 0], -0.7 * found.forces[:, 2], atol=SOLVED * case.units.weight)
    assert_allclose(found.forces[:, 1], 0.0, atol=SOLVED * case.units.weight)
