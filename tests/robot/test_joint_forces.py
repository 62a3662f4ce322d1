"""Springs, damping and friction at joints, springs in series, and joints that cannot be moved."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import one_phase
from tests.support.refusals import refused
from trajopt import InputError, Robot, Solution
from trajopt.errors import UnsupportedJointError
from trajopt.inspection.faults import find_faults
from trajopt.inspection.standing import standing_posture
from trajopt.robot import Drive, JointForce
from trajopt.robot.actuators.joint_force import SPRING
from trajopt.robot.joint_checks import joints_without_inertia
from trajopt.terms import TerminalRest, TerminalState, TorqueCost, effort_costs
from trajopt_library import problems, robots

SOLVED = 1e-6


def oscillator(*forces: JointForce) -> Robot:
    """2 kg on a slide along x, without a motor."""
    model = pin.Model()
    model.name = "oscillator"
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    return Robot.from_model(model, passive=["slide"]).with_joint_forces(forces)


def fall(robot: Robot, v: float, duration: float) -> Solution:
    """The motion that nothing drives, from q = 1 m at v m/s."""
    start = {"initial_q": np.array([1.0]), "initial_v": np.array([v])}
    problem = one_phase(robot, duration=duration, guess=lambda t: np.array([1.0]), **start)
    return trajopt.solve(problem, transcription="legendre:3", intervals=60)


def test_a_mass_on_a_spring_swings_as_its_closed_form() -> None:
    solution = fall(oscillator(JointForce(joint="slide", stiffness=50.0, rest=0.4)), 0.0, 1.7)
    assert_allclose(solution.q[:, 0], 0.4 + 0.6 * np.cos(5.0 * solution.t), atol=1e-6)
    report = trajopt.check(solution)
    assert report.ok, report.failures()


def test_damping_and_dry_friction_slow_a_mass_as_their_closed_forms() -> None:
    damped = fall(oscillator(JointForce(joint="slide", damping=3.0)), 2.0, 1.0)
    assert_allclose(damped.v[:, 0], 2.0 * np.exp(-1.5 * damped.t), atol=1e-7)
    rubbed = fall(oscillator(JointForce(joint="slide", dry_friction=4.0)), 3.0, 1.0)
    assert rubbed.converged
    assert_allclose(rubbed.v[:, 0], 3.0 - 2.0 * rubbed.t, atol=1e-6)
    assert trajopt.check(rubbed).ok


def test_damping_of_a_description_counts_where_it_is_asked_for() -> None:
    robot = robots.load("double_pendulum")
    assert robot.joint_forces == ()
    described = robot.with_joint_forces()
    assert {force.joint for force in described.joint_forces} == {"joint1", "joint2"}
    assert_allclose([force.damping for force in described.joint_forces], robot.model.damping)
    assert described.with_locked(["joint2"]).joint_forces == described.joint_forces[:1]


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"joint": "knee"}, InputError, "'knee' of a force is unknown; one of slide"),
        ({"stiffness": -1.0}, InputError, "stiffness"),
        ({"dry_speed": 0.0}, InputError, "dry_speed"),
        ({"damping": math.nan}, InputError, "damping"),
    ],
)
def test_forces_that_cannot_be_are_refused(changed, error, message) -> None:
    with pytest.raises(error, match=message):
        oscillator(JointForce(**{"joint": "slide", "stiffness": 1.0, **changed}))


def test_springs_need_a_joint_of_one_coordinate() -> None:
    with pytest.raises(UnsupportedJointError, match="springs of one coordinate"):
        robots.load("double_pendulum").with_joint_forces([JointForce(joint="joint1", stiffness=1.0)])
    with pytest.raises(UnsupportedJointError, match="one degree of freedom"):
        robots.load("go2").with_joint_forces([JointForce(joint="root_joint", damping=1.0)])


@pytest.mark.long
def test_legs_with_springs_and_friction_jump_and_their_torques_are_those_of_the_motors(tmp_path) -> None:
    problem = problems.load("solo12-jump")
    knees = [name for name in problem.robot.model.names if name.endswith("KFE")]
    springs = [
        JointForce(
            joint=name, stiffness=2.0, rest=1.0 if "F" in name[0] else -1.0, damping=0.01, dry_friction=0.02
        )
        for name in knees
    ]
    solution = trajopt.solve(replace(problem, robot=problem.robot.with_joint_forces(springs)))
    assert solution.success, solution.statistics.failures
    read = Solution.load(solution.save(tmp_path / "jump.npz"))
    assert read.description.joint_forces == tuple(springs)
    assert trajopt.check(read).ok
    model, data = read.model, read.model.createData()
    frames = [model.getFrameId(name) for name in read.contact_frames]
    for k in np.flatnonzero(read.collocation)[::7]:
        force = pin.rnea(model, data, read.q[k], read.v[k], read.a[k])
        for frame, wrench in zip(frames, read.f[k], strict=True):
            jacobian = pin.computeFrameJacobian(model, data, read.q[k], frame, pin.LOCAL_WORLD_ALIGNED)
            force -= jacobian.T @ wrench
        for spring in springs:
            q, v = spring.entries(model)
            rate = read.v[k, v]
            force[v] += (
                spring.stiffness * (read.q[k, q] - spring.rest) + 0.01 * rate + 0.02 * np.tanh(rate / 0.1)
            )
        assert_allclose(force, np.append(np.zeros(6), read.tau[k]), atol=1e-5)


def test_a_series_spring_splits_a_joint_into_gear_and_link() -> None:
    robot = robots.load("ur5").with_drives({"elbow_joint": Drive(gear_ratio=101.0, rotor_inertia=1e-5)})
    elastic = robot.with_series_springs({"elbow_joint": 8000.0})
    assert (elastic.nv, elastic.nu) == (7, 6)
    assert elastic.passive == ("elbow_joint_spring",)
    assert elastic.torque_limit.tolist() == robot.torque_limit.tolist()
    assert elastic.drives == robot.drives
    random = np.random.default_rng(0)
    q, v, a = random.normal(size=(3, 6))
    row = elastic.model.joints[elastic.model.getJointId("elbow_joint_spring")].idx_v
    split = [np.insert(part, row, 0.0) for part in (q, v, a)]
    stiff = pin.rnea(elastic.model, elastic.model.createData(), *split)
    plain = pin.rnea(robot.model, robot.model.createData(), q, v, a)
    assert_allclose(np.delete(stiff, row), plain, atol=1e-9)
    gear = robot.model.armature[2] * a[2]
    assert_allclose(stiff[row], plain[2] - gear, atol=1e-9)  # the rotor's inertia is not behind the spring
    tool = [model.getFrameId("tool0") for model in (elastic.model, robot.model)]
    poses = []
    for model, frame, at in zip((elastic.model, robot.model), tool, (split[0], q), strict=True):
        data = model.createData()
        pin.framesForwardKinematics(model, data, at)
        poses.append(data.oMf[frame].homogeneous)
    assert_allclose(*poses, atol=1e-9)


def test_a_series_spring_needs_a_rotor() -> None:
    with pytest.raises(InputError, match="'elbow_joint' has no armature"):
        robots.load("ur5").with_series_springs({"elbow_joint": 8000.0})
    with pytest.raises(InputError, match="'knee' of a series spring is unknown"):
        robots.load("ur5").with_series_springs({"knee": 8000.0})


@pytest.mark.long
def test_a_link_behind_a_soft_series_spring_moves_from_rest_to_rest() -> None:
    """The deflection of the spring is the torque of the link, at any time."""
    model = pin.Model()
    model.name, model.gravity.linear = "link", np.zeros(3)
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.2 * np.eye(3)), pin.SE3.Identity())
    model.armature = np.array([0.05])
    robot = Robot.from_model(model).with_series_springs({"turn": 4.0})
    end = np.array([1.0, 0.0])
    goal = TorqueCost(weight=1.0), TerminalState(q=end), TerminalRest(q=end)
    problem = one_phase(robot, *goal, duration=1.5, guess=lambda t: end * t / 1.5)
    solution = trajopt.solve(problem)
    assert solution.success
    points = solution.collocation
    torque = 0.2 * solution.a.sum(axis=1)
    assert_allclose(-4.0 * solution.q[points, 1], torque[points], atol=SOLVED * 10)
    assert np.abs(solution.q[:, 1]).max() > 0.05
    assert trajopt.check(solution).ok


def test_springs_hold_in_mujoco() -> None:
    pytest.importorskip("mujoco")
    robot = robots.load("ur5").with_joint_forces(
        [JointForce(joint="elbow_joint", stiffness=20.0, rest=1.0, damping=0.3)]
    )
    end = robot.reference.copy()
    end[[0, 2]] += 0.3
    goal = *effort_costs(), TerminalState(q=end), TerminalRest(q=end)
    problem = one_phase(robot, *goal, guess=lambda t: robot.reference + t * (end - robot.reference))
    simulated = trajopt.simulate(trajopt.solve(problem))
    assert simulated.report.passed, simulated.report.failures
    assert simulated.report.saturated == 0.0


def test_series_springs_stay_with_the_friction_of_the_description() -> None:
    robot = robots.load("ur5")
    model = robot.model.copy()
    model.armature[:], model.upperDryFrictionLimit[:] = 0.1, 0.2
    robot, name = replace(robot, model=model), model.names[2]
    elastic = robot.with_series_springs({name: 300.0})
    again = elastic.with_joint_forces()
    assert elastic.joint_forces[0] in again.joint_forces
    assert len(again.joint_forces) == 1 + len(robot.with_joint_forces().joint_forces) == 7
    softer = elastic.with_joint_forces([JointForce(joint=name + SPRING, stiffness=10.0)])
    assert [force.stiffness for force in softer.joint_forces] == [10.0]
    with pytest.raises(InputError, match=f"stiffness of the series spring of joint '{name}' is 0.0; above 0"):
        robot.with_series_springs({name: 0.0})


SMALL = 1e-7  # kg m^2, of a finger's last link


def chain(*links: pin.Inertia, armature: float = 0.0, axes: str = "yyy") -> Robot:
    """An arm whose joints 'j0', 'j1', ... turn about ``axes``, a link of 0.3 m behind each."""
    model, parent = pin.Model(), 0
    kinds = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}
    for index, (link, axis) in enumerate(zip(links, axes, strict=False)):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3 if index else 0.0]))
        parent = model.addJoint(parent, kinds[axis](), place, f"j{index}")
        model.addJointFrame(parent)
        model.appendBodyToJoint(parent, link, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15])))
    model.armature = np.full(model.nv, armature)
    limits = {"velocity_limit": np.full(model.nv, 3.0), "torque_limit": np.full(model.nv, 50.0)}
    return replace(Robot.from_model(model, name="chain"), **limits)


BAR, NOTHING = pin.Inertia.FromBox(2.0, 0.05, 0.05, 0.3), pin.Inertia.Zero()
POINT = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
FINGER = pin.Inertia(1e-5, np.zeros(3), SMALL * np.eye(3))


@pytest.mark.parametrize(
    ("robot", "expected"),
    [
        (chain(BAR, BAR), []),
        (chain(BAR, NOTHING), ["j1"]),
        (chain(BAR, NOTHING, NOTHING), ["j1", "j2"]),
        (chain(BAR, NOTHING, BAR), []),
        (chain(BAR, NOTHING, armature=1e-4), []),
        (chain(BAR, FINGER), []),
        (chain(BAR, POINT, axes="yz"), ["j1"]),
        (chain(BAR, NOTHING, POINT, axes="yzy"), []),
    ],
)
def test_a_joint_without_inertia_is_found_wherever_it_moves_none(robot: Robot, expected: list[str]) -> None:
    assert joints_without_inertia(robot) == expected


@pytest.mark.parametrize("name", robots.names())
def test_all_joints_of_the_library_can_be_moved(name: str) -> None:
    robot = robots.load(name)
    assert joints_without_inertia(robot) == []
    assert np.all(robot.velocity_limit[robot.actuated_rows] > 0)
    assert robot.torque_limit is None or np.all(robot.torque_limit > 0)


def test_a_problem_with_torques_needs_inertia() -> None:
    robot = chain(BAR, NOTHING)
    with refused(r"no inertia is moved by joint 'j1' of 'chain'.*lock it"):
        one_phase(robot, TorqueCost(weight=1.0))
    assert one_phase(robot, actuation="acceleration").robot is robot
    assert one_phase(robot.with_locked(["j1"]), TorqueCost(weight=1.0)).robot.nv == 1


def test_a_report_says_which_joints_move_nothing() -> None:
    robot = chain(BAR, POINT, axes="yz")
    assert any("no inertia is moved by j1" in line for line in find_faults(robot, standing_posture(robot)))


@pytest.mark.parametrize("family", ["arm-reach", "arm-avoid", "arm-pick-place", "arm-transfer", "arm-wipe"])
def test_an_arm_whose_limits_are_zero_is_one_line(
    family: str, monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    file = tmp_path / "still.py"
    file.write_text(
        "import numpy as np\nfrom dataclasses import replace\nfrom trajopt_library import robots\n"
        "def build():\n    ur5 = robots.load('ur5')\n    return replace(ur5, velocity_limit=np.zeros(6))\n"
    )
    with pytest.raises(InputError, match=r"velocity limit of joint 'shoulder_pan_joint' and 5 more"):
        trajopt.load(family, robot=str(file))


def test_a_jump_of_legs_whose_limits_are_zero_is_one_line(tmp_path) -> None:
    file = tmp_path / "still.py"
    file.write_text(
        "import numpy as np\nfrom dataclasses import replace\nfrom trajopt_library import robots\n"
        "def build():\n    go2 = robots.load('go2')\n    return replace(go2, torque_limit=np.zeros(12))\n"
    )
    with pytest.raises(InputError, match=r"torque limit of joint '\w+' and 11 more of 'go2' is 0"):
        trajopt.load("quadruped-jump-up", robot=str(file))
