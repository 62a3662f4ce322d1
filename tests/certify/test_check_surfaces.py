"""The check of contacts on walls, slopes and soles, of grasps and impacts, and of velocity sources."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.problems import landing, still
from tests.support.refusals import refused
from tests.support.synthetic_motions import Motion, sampled, with_meta
from trajopt import Contact, FlatGround, Robot, Solution, check
from trajopt.certify.report import Tolerances
from trajopt.errors import SolutionFileError
from trajopt.terrain import Surface
from trajopt_library import problems

EXACT = 1e-9  # a body at rest; only rounding remains
MASS, GRAVITY = 2.0, 9.81
LENGTH, WIDTH, HEIGHT = 0.1, 0.05, 0.08  # half sizes of the sole, height of the centre of mass, m
SLOPE, FRICTION = 0.3, 0.5
POINT = np.array([0.2, 0.1, -0.5])


def at_rest(contact: str, q: np.ndarray, wrench: np.ndarray) -> Motion:
    """A free body that rests at q (7,) with a wrench (6,) at its contact."""
    still = np.zeros(6)
    return Motion(
        duration=0.2,
        contacts=(contact,),
        q=lambda t: q,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: np.zeros(0),
        f=lambda t: wrench[None],
    )


def box_at(placement: pin.SE3, yaw_moment: float = 0.0) -> Solution:
    """A box that rests on its sole, placed anywhere; ``yaw_moment`` in N m about the sole's normal."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    inertia = pin.Inertia(MASS, np.array([0.0, 0.0, HEIGHT]), 0.01 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("sole", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    sole = Contact(frame="sole", name="foot", kind="surface", half_length=LENGTH, half_width=WIDTH)
    robot = Robot.from_model(model, name="box", contacts=[sole])
    force = np.array([0.0, 0.0, MASS * GRAVITY])
    lever = placement.rotation @ [0.0, 0.0, HEIGHT]
    moment = np.cross(lever, force) + yaw_moment * placement.rotation[:, 2]
    motion = at_rest("foot", pin.SE3ToXYZQUAT(placement), np.concatenate([force, moment]))
    return sampled(robot, [motion], 4, contact_sizes=[[LENGTH, WIDTH]], friction=[FRICTION])


def on(solution: Solution, surface: Surface) -> Solution:
    return with_meta(solution, surfaces=[{"sole": surface.describe()}])


def sloping(angle: float, friction: float = FRICTION) -> Surface:
    normal = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    return Surface(point=POINT, normal=normal, friction=friction)


def resting_on(surface: Surface) -> Solution:
    return on(box_at(pin.SE3(surface.frame, surface.point)), surface)


def test_box_on_a_slope_has_the_margins_of_statics():
    report = check(resting_on(sloping(SLOPE)))
    assert report.ok, report.failures()
    along, across = np.cos(SLOPE), np.sin(SLOPE)
    assert report.unilateral_margin == pytest.approx(along)
    assert report.friction_margin == pytest.approx(FRICTION * along - across)
    yaw = FRICTION * (LENGTH + WIDTH) * along - (WIDTH + FRICTION * HEIGHT) * across
    assert report.sole_margin == pytest.approx(min(WIDTH * along, LENGTH * along - HEIGHT * across, yaw))
    assert report.landing_height < EXACT
    assert report.penetration < EXACT  # half a metre below the terrain, but on its own surface
    assert report.sole_tilt < EXACT


def test_slope_may_be_the_terrain():
    surface = sloping(SLOPE)
    box, ground = resting_on(surface), FlatGround(height=0.2, normal=tuple(surface.normal))
    placement = pin.SE3(surface.frame, ground.surface.point)
    box = box_at(placement)
    report = check(with_meta(box, terrain=ground.describe()))
    assert report.ok, report.failures()
    assert report.friction_margin == pytest.approx(FRICTION * np.cos(SLOPE) - np.sin(SLOPE))


def test_box_slides_beyond_the_friction_angle():
    assert check(resting_on(sloping(np.arctan(0.45)))).ok
    assert check(resting_on(sloping(np.arctan(0.55)))).failures() == (
        "friction_margin",
        "friction_margin_between",
    )


def test_box_tips_where_its_weight_leaves_the_sole():
    steep = sloping(np.arctan(1.1 * LENGTH / HEIGHT), friction=2.0)
    assert check(resting_on(steep)).failures() == ("sole_margin",)


def test_bolt_holds_what_a_ceiling_drops():
    ceiling = Surface(point=POINT, normal=[0.0, 0.0, -1.0], friction=FRICTION)
    dropped = check(resting_on(ceiling))
    margins = {"friction_margin", "unilateral_margin", "sole_margin"}
    assert set(dropped.failures()) == {f"{name}{when}" for name in margins for when in ("", "_between")}
    held = check(resting_on(replace(ceiling, bilateral=True)))
    assert held.ok, held.failures()
    assert held.friction_margin is held.unilateral_margin is held.sole_margin is None


@pytest.mark.parametrize("turn", [0.0, 0.6])
def test_yaw_moment_is_held_up_to_friction_times_the_half_sizes(turn):
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, turn), np.zeros(3))
    most = FRICTION * (LENGTH + WIDTH) * MASS * GRAVITY
    for sign in (1, -1):
        assert check(box_at(placement, 0.99 * sign * most)).sole_margin > 0
        assert check(box_at(placement, 1.01 * sign * most)).sole_margin < 0


def test_contact_off_its_surface_is_found():
    surface = sloping(SLOPE)
    above = on(box_at(pin.SE3(surface.frame, surface.point + 0.02 * surface.normal)), surface)
    report = check(above)
    assert report.failures() == ("landing_height",)
    assert report.landing_height == pytest.approx(0.02)
    below = check(on(box_at(pin.SE3(surface.frame, surface.point - 0.02 * surface.normal)), surface))
    assert set(below.failures()) == {"landing_height", "penetration"}
    assert below.penetration == pytest.approx(0.02)


@pytest.mark.parametrize("angle", [0.05, 3.0])
def test_sole_that_is_not_flat_on_its_surface_is_found(angle):
    surface = sloping(0.0)
    tilted = on(box_at(pin.SE3(pin.rpy.rpyToMatrix(0.0, angle, 0.0), surface.point)), surface)
    report = check(tilted)
    assert "sole_tilt" in report.failures()
    assert report.sole_tilt == pytest.approx(angle)


WRONG = {
    "no list": ({"sole": sloping(0.1).describe()}, "is not null or a list"),
    "two phases": ([{}, {}], "2 entries for 1 phases"),
    "no such contact": ([{"hand": sloping(0.1).describe()}], "names hand, not in contact"),
    "no normal": ([{"sole": {"point": [0, 0, 0]}}], "surfaces of meta: "),
    "normal of zero": ([{"sole": {**sloping(0.1).describe(), "normal": [0, 0, 0]}}], "no length"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_surfaces_in_a_file_are_refused_in_one_line(case, tmp_path):
    surfaces, message = WRONG[case]
    box = box_at(pin.SE3.Identity())
    with refused(message):
        check(with_meta(box, surfaces=surfaces))


def test_surfaces_survive_a_file(tmp_path):
    solution = resting_on(sloping(SLOPE))
    loaded = Solution.load(solution.save(tmp_path / "box.npz"))
    assert loaded.meta["surfaces"] == solution.meta["surfaces"]
    assert check(loaded).to_dict() == check(solution).to_dict()


def test_terrain_of_another_kind_is_refused():
    box = box_at(pin.SE3.Identity())
    for terrain, message in (({"kind": "stairs"}, "stairs"), ({"kind": "flat", "normal": "up"}, "normal")):
        with pytest.raises(SolutionFileError, match=message):
            check(with_meta(box, terrain=terrain))


def box_on_a_sole(offset: float) -> tuple[Robot, Motion]:
    """A box of 2 kg that rests on one sole, its centre of mass ``offset`` m before the sole's origin."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    inertia = pin.Inertia(2.0, np.array([offset, 0.0, 0.3]), 0.01 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("sole", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    sole = Contact(frame="sole", kind="surface", half_length=0.1, half_width=0.05)
    robot = Robot.from_model(model, name="box", contacts=[sole])
    weight = 2 * 9.81
    wrench = np.array([0.0, 0.0, weight, 0.0, -weight * offset, 0.0])
    return robot, at_rest("sole", pin.neutral(model), wrench)


@pytest.mark.parametrize(("offset", "failures"), [(0.03, ()), (0.12, ("sole_margin", "sole_margin_between"))])
def test_surface_contact_holds_force_and_moment(offset, failures):
    robot, motion = box_on_a_sole(offset)
    report = check(sampled(robot, [motion], 3, contact_sizes=[[0.1, 0.05]]))
    assert report.failures() == failures
    assert report.sole_margin == pytest.approx(min(0.1 - offset, 0.7 * 0.075, 0.05))
    assert report.base_residual < EXACT
    assert report.foot_turn == 0
    assert report.open_loop_position < EXACT
    assert report.open_loop_orientation < EXACT


def test_turning_sole_is_measured():
    robot, motion = box_on_a_sole(0.0)
    still = sampled(robot, [motion], 3)
    turned = still.q.copy()
    turned[-1, 3:7] = pin.Quaternion(pin.exp3(np.array([0.0, 0.0, 0.2]))).coeffs()
    report = check(replace(still, q=turned))
    assert report.foot_turn == pytest.approx(0.2)
    assert report.sole_margin is None


# What a solver leaves that stops at 1e-6 in units of weight and length.
MET = 1e-6
# Friction at the nodes of a coarse mesh, where its bound becomes inactive.
COARSE = Tolerances(between=0.05)


@lru_cache
def landed() -> Solution:
    solution = trajopt.solve(landing(impact=True), intervals=16, transcription="legendre:3")
    assert solution.converged
    return solution


def test_impact_of_a_solution_meets_its_law_and_loses_energy():
    report = trajopt.check(landed())
    assert report.within(COARSE)
    assert report.impact_residual < MET
    assert report.impact_velocity < MET
    assert report.impact_momentum_error < MET
    assert report.impact_friction_margin > -MET
    assert report.impact_energy_gain < 0


def test_figures_of_impacts_are_none_without_one():
    report = trajopt.check(trajopt.solve(landing(), intervals=10))
    assert report.impact_residual is None
    assert report.impact_friction_margin is None
    assert report.state_jump == 0.0


@pytest.mark.parametrize(
    ("factor", "failing"),
    [
        (1.1, {"impact_residual", "impact_momentum_error"}),
        (-1.0, {"impact_residual", "impact_momentum_error", "impact_friction_margin"}),
    ],
)
def test_impulse_that_is_not_the_impacts_is_found(factor, failing):
    wrong = trajopt.check(replace(landed(), impulse=factor * landed().impulse))
    assert set(wrong.failures(COARSE)) == failing


def test_velocity_that_jumps_without_an_impact_is_found():
    hidden = replace(landed(), impulse=None, impact_index=None)
    report = trajopt.check(hidden)
    assert report.state_jump > 1e-3
    assert report.failures(COARSE) == ("state_jump",)


def test_impact_at_a_sample_within_an_interval_is_refused():
    with refused("'impact_index' holds 3, which is not the first sample of an interval after"):
        trajopt.check(replace(landed(), impact_index=np.array([3])))


def test_statics_of_a_velocity_source_are_judged_not_its_dynamics():
    solution = trajopt.solve(still(), intervals=10)
    assert solution.converged
    assert solution.description.actuation == "velocity"
    report = trajopt.check(solution)
    assert report.ok
    assert report.base_residual < MET
    assert not trajopt.check(with_meta(solution, actuation="torque")).ok


def test_open_loop_of_a_velocity_source_follows_its_rates():
    arm = problems.load("ur5-reach")
    keep = [term for term in arm.terms if type(term).__name__ in ("FramePose", "PositionLimits")]
    problem = replace(arm, actuation="velocity", terms=(trajopt.terms.VelocityCost(weight=1.0), *keep))
    coarse, fine = (
        trajopt.check(trajopt.solve(problem, intervals=n, transcription="legendre:3")) for n in (4, 8)
    )
    assert coarse.open_loop_joints < 1e-8
    assert fine.ok
