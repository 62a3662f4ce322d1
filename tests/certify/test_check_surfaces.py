"""The check of contacts on surfaces that are not the terrain: slopes, ceilings, grasps."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.support.synthetic_motions import Motion, sampled, with_meta
from trajopt.certify.check import check
from trajopt.errors import InputError, SolutionFileError
from trajopt.robot.contact import Contact
from trajopt.robot.robot import Robot
from trajopt.solution.solution import Solution
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import Surface

EXACT = 1e-9  # a body at rest; only rounding remains
MASS, GRAVITY = 2.0, 9.81
LENGTH, WIDTH, HEIGHT = 0.1, 0.05, 0.08  # half sizes of the sole, height of the centre of mass, m
SLOPE, FRICTION = 0.3, 0.5
POINT = np.array([0.2, 0.1, -0.5])


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
    q, still = pin.SE3ToXYZQUAT(placement), np.zeros(6)
    motion = Motion(
        duration=0.2,
        contacts=("foot",),
        q=lambda t: q,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: np.zeros(0),
        f=lambda t: np.concatenate([force, moment])[None],
    )
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
    with pytest.raises(InputError, match=message) as caught:
        check(with_meta(box, surfaces=surfaces))
    assert "\n" not in str(caught.value)


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
