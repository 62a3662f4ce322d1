"""Rows of tasks against finite differences of what they speak of, and their feedback."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from trajopt.control import (
    AngularMomentumTask,
    CenterOfMassTask,
    ContactForceTask,
    FrameTask,
    PostureTask,
    RegularisationTask,
    RobotState,
    Task,
)
from trajopt.control.contact_forces import ActiveContact
from trajopt.errors import InputError
from trajopt_library import robots

STEP = 1e-6
# Of a difference over STEP, of rates up to tens.
DIFFERENCED = 2e-4
SEED = 4


def state_of(name: str) -> tuple[RobotState, np.ndarray]:
    """A random state, and a random acceleration (nv,)."""
    generator = np.random.default_rng(SEED)
    robot = robots.load(name)
    q = pin.integrate(robot.model, robot.reference, 0.3 * generator.standard_normal(robot.nv))
    state = RobotState(robot.model)
    state.update(q, generator.standard_normal(robot.nv))
    return state, generator.standard_normal(robot.nv)


def after(state: RobotState, a: np.ndarray) -> RobotState:
    """The state a step later under constant acceleration."""
    later = RobotState(state.model)
    later.update(pin.integrate(state.model, state.q, STEP * state.v + STEP**2 / 2 * a), state.v + STEP * a)
    return later


def frame_of(state: RobotState) -> int:
    return int(state.model.nframes - 1)


def tasks(state: RobotState) -> dict[str, tuple[Task, np.ndarray]]:
    """Tasks without feedback that ask for nothing, and the rate of what each one speaks of."""
    zero, nv = np.zeros(3), state.model.nv
    own = state.frame(frame_of(state))
    posture = PostureTask(
        q=state.q,
        v=state.v,
        a=np.zeros(nv),
        bandwidth=0.0,
        rows_of_v=np.arange(nv),
        weights=np.ones(nv),
        unit=np.ones(nv),
    )
    return {
        "centre of mass": (
            CenterOfMassTask(position=zero, velocity=zero, acceleration=zero, bandwidth=0.0),
            state.centre_of_mass()[1],
        ),
        "angular momentum": (
            AngularMomentumTask(momentum=zero, rate=zero, bandwidth=0.0),
            state.angular_momentum()[0],
        ),
        "frame": (
            FrameTask(
                frame=frame_of(state),
                pose=own.placement,
                velocity=np.zeros(6),
                acceleration=np.zeros(6),
                bandwidth=0.0,
                selection=np.eye(6),
            ),
            own.velocity,
        ),
        "posture": (posture, state.v),
        "regularisation": (RegularisationTask(unit=np.ones(nv)), state.v),
    }


@pytest.mark.parametrize("name", ["go2", "talos", "hopper", "ur5"])
@pytest.mark.parametrize("kind", ["centre of mass", "angular momentum", "frame", "posture", "regularisation"])
def test_rows_are_the_rate_of_change_of_what_is_asked(name: str, kind: str) -> None:
    state, a = state_of(name)
    task, before = tasks(state)[kind]
    _, then = tasks(after(state, a))[kind]
    rows = task.rows(state, [])
    # A x - b with b = -drift is dJ v + J a.
    assert_allclose(rows.acceleration @ a - rows.value, (then - before) / STEP, atol=DIFFERENCED, rtol=1e-4)


def test_feedback_is_that_of_a_critically_damped_oscillator() -> None:
    state, _ = state_of("go2")
    position, velocity, jacobian, drift = state.centre_of_mass()
    error, w = np.array([0.1, -0.2, 0.05]), 7.0
    task = CenterOfMassTask(
        position=position + error, velocity=velocity, acceleration=np.zeros(3), bandwidth=w, unit=2.0
    )
    rows = task.rows(state, [])
    assert_allclose(rows.value, (w**2 * error - drift) / 2.0)
    assert_allclose(rows.acceleration, jacobian / 2.0)


def test_a_turned_frame_is_turned_back_about_the_same_axis() -> None:
    state, _ = state_of("go2")
    state.update(state.q, np.zeros(state.model.nv))
    own = state.frame(frame_of(state))
    turn = np.array([0.0, 0.0, 0.3])
    goal = pin.SE3(pin.exp3(turn) @ own.placement.rotation, own.placement.translation)
    task = FrameTask(
        frame=frame_of(state),
        pose=goal,
        velocity=np.zeros(6),
        acceleration=np.zeros(6),
        bandwidth=3.0,
        selection=np.eye(6)[3:],
    )
    assert_allclose(task.rows(state, []).value, 9.0 * turn, atol=1e-9)


def test_forces_are_picked_by_contact() -> None:
    state, _ = state_of("go2")
    up = np.array([0.0, 0.0, 1.0])
    contacts = [ActiveContact(number=i, frame=2, dimension=3, normal=up, friction=0.5) for i in (2, 0)]
    wanted = np.arange(24.0).reshape(4, 6)
    rows = ContactForceTask(wanted=wanted, units=(10.0, 1.0)).rows(state, contacts)
    assert rows.force is not None
    assert_allclose(rows.value, np.concatenate([wanted[2, :3], wanted[0, :3]]) / 10.0)
    assert_allclose(rows.force, np.eye(6) / 10.0)


def test_frames_have_names_and_unknown_ones_are_refused() -> None:
    state, _ = state_of("go2")
    number = state.model.getFrameId("FL_foot")
    assert_allclose(state.frame("FL_foot").jacobian, state.frame(number).jacobian)
    with pytest.raises(InputError, match=r"a task or contact names frame 'FL_fot'.*close matches: .*FL_foot"):
        state.frame("FL_fot")
    with pytest.raises(InputError, match="is of frame 9999; allowed: a frame's name, or an index from 0 to"):
        state.frame(9999)


def test_a_contact_without_a_wanted_force_is_refused() -> None:
    state, _ = state_of("go2")
    contact = ActiveContact(number=4, frame="FL_foot", dimension=3, normal=np.eye(3)[2], friction=0.5)
    with pytest.raises(InputError, match="no force of contact 4; allowed: contacts 0 to 3"):
        ContactForceTask(wanted=np.zeros((4, 6))).rows(state, [contact])


def test_a_priority_is_one_or_two() -> None:
    with pytest.raises(InputError, match="priority of RegularisationTask is 3; allowed: 1 or 2"):
        RegularisationTask(unit=np.ones(3), priority=3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda q, v: (q[:-1], v), r"q of a state has shape \(18,\); allowed: \(19,\)"),
        (lambda q, v: (q, np.full_like(v, np.nan)), r"v\[0\] of a state is nan; allowed: finite numbers"),
    ],
)
def test_states_that_are_none_are_refused(change, message) -> None:
    state, _ = state_of("go2")
    with pytest.raises(InputError, match=message):
        state.update(*change(state.q, state.v))
