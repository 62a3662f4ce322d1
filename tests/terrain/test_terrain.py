"""Terrain in schedules, problems, the check, the replay, and a motion; bad input."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.ground import HILLS, STAIRS
from tests.support.problems import FOOT, hop, hopper
from tests.support.refusals import assert_refused_in_one_line
from tests.support.replay_pages import shown
from tests.support.synthetic_motions import Motion, sampled, standing, with_meta
from trajopt.certify.check import check
from trajopt.errors import InputError, SolutionFileError
from trajopt.motion.solution import Solution
from trajopt.robot.kinematics import contact_positions
from trajopt.schedule.placing import placed_on
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.solving import solve
from trajopt.terms import FrictionCone, FrictionPyramid, SwingClearance
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.shapes import Bump, Incline, Wave
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.terrain.swing_paths import swing_path
from trajopt.terrain.terrain import terrain_from_description
from trajopt_library import robots
from trajopt_library.robots import solo12

ROUNDING = 1e-12  # numbers of order one after a few products
SOLVED = 1e-6  # rows of a solve that stops at 1e-8, over their units


# Schedules and problems on terrain


def test_footholds_are_laid_onto_the_ground():
    landing = Phase(name="on", duration=0.1, contacts=(FOOT,), footholds={FOOT: np.array([0.28, 0.1, 0.0])})
    schedule = Schedule((landing,))
    stairs = PiecewiseTerrain.stairs(0.1, 0.3, 3, margin=0.05)
    fixed = placed_on(schedule, stairs).phases[0]
    assert_allclose(fixed.footholds[FOOT], [0.25, 0.1, 0.1])
    free = placed_on(schedule, stairs, free=True).phases[0]
    assert not free.footholds
    assert free.patches[FOOT] is stairs.face("step1")
    smooth = placed_on(schedule, HILLS).phases[0]
    assert_allclose(smooth.footholds[FOOT], [0.28, 0.1, HILLS.height(0.28, 0.1)], atol=ROUNDING)
    with pytest.raises(InputError, match="over a hole"):
        placed_on(schedule, PiecewiseTerrain.gap(0.5))


def landing_at(foothold: tuple[float, float, float]) -> Schedule:
    stance, flight, landing = hop().schedule.phases
    return Schedule((stance, flight, replace(landing, footholds={FOOT: np.array(foothold)})))


BAD = {
    "no face": (lambda: PiecewiseTerrain(faces=()), "at least one"),
    "two faces of one name": (lambda: PiecewiseTerrain(faces=STAIRS.faces[:1] * 2), "the same name"),
    "unknown face": (lambda: STAIRS.face("roof"), "step1"),
    "wall as ground": (
        lambda: PiecewiseTerrain(
            faces=(
                Patch(
                    surface=Surface(point=np.zeros(3), normal=np.array([1.0, 0, 0])),
                    vertices=np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1.0]]),
                ),
            )
        ),
        "z > 0",
    ),
    "no steps": (lambda: PiecewiseTerrain.stairs(0.1, 0.3, 0), ">= 1"),
    "run of nothing": (lambda: PiecewiseTerrain.stairs(0.1, 0.0, 2), "> 0"),
    "infinite box": (lambda: PiecewiseTerrain.box(np.inf, 1.0, 1.0), "finite"),
    "obstacle nowhere": (lambda: PiecewiseTerrain.gap(0.1, at=(np.nan, 0.0)), "finite"),
    "heights for other stones": (lambda: PiecewiseTerrain.stepping_stones([(0, 0)], 0.1, [0, 1]), "one"),
    "no shapes": (lambda: SmoothTerrain(shapes=()), "at least one"),
    "bump without radius": (lambda: Bump(rise=0.1, radius=0.0), "> 0"),
    "text as a slope": (lambda: Incline(slope_x="steep"), "finite"),
    "friction": (lambda: SmoothTerrain(shapes=HILLS.shapes, friction=-1.0), ">= 0"),
    "unknown shape": (
        lambda: terrain_from_description({"kind": "smooth", "friction": 0.5, "shapes": [{}]}),
        "bump",
    ),
    "unknown terrain": (lambda: terrain_from_description({"kind": "swamp"}), "piecewise"),
    "clearance over edges": (lambda: SwingClearance(height=0.1, terrain=STAIRS), "swing_clearance"),
    "negative clearance": (lambda: swing_path(STAIRS, -0.1), ">= 0"),
    "sole on curved ground": (lambda: hop("surface", terrain=HILLS), "point contacts"),
    "landing on no face": (lambda: hop(terrain=STAIRS), "a patch"),
    "start over a hole": (
        lambda: hop(terrain=PiecewiseTerrain.gap(1.0, at=(-0.5, 0.0)), schedule=landing_at((2.0, 0, 0.0))),
        "no face",
    ),
    "foothold in the air": (
        lambda: hop(terrain=STAIRS, schedule=landing_at((0.1, 0, 0.0))),
        "within 1e-06 m",
    ),
    "foothold in the hill": (
        lambda: hop(terrain=HILLS, schedule=landing_at((0.1, 0, 0.0))),
        "within 0.001 m",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_line(case):
    assert_refused_in_one_line(*BAD[case])


# The check


def stands() -> Solution:
    """Solo12 at rest on level ground at height 0, one foot said to be in the air."""
    robot = robots.load("solo12")
    still = standing(robot)
    lifted = Motion(
        duration=still.duration,
        contacts=still.contacts[1:],
        q=still.q,
        v=still.v,
        a=still.a,
        tau=still.tau,
        f=still.f,
    )
    return sampled(robot, [lifted], 2)


def on_terrain(solution: Solution, terrain: PiecewiseTerrain | SmoothTerrain) -> Solution:
    return with_meta(solution, terrain=terrain.describe())


@pytest.mark.long
def test_foot_in_a_step_penetrates_by_the_whole_height_of_it():
    solution = stands()
    feet = contact_positions(robots.load("solo12"), solution.q[0])
    x = feet["FL_FOOT"][0]
    assert (
        check(on_terrain(solution, PiecewiseTerrain.stairs(0.1, 0.3, 1, at=(x + 0.02, 0)))).penetration
        < ROUNDING
    )
    assert check(
        on_terrain(solution, PiecewiseTerrain.stairs(0.1, 0.3, 1, at=(x - 0.02, 0)))
    ).penetration == (pytest.approx(0.1))


def test_foot_over_a_hole_penetrates_nothing():
    solution = stands()
    report = check(on_terrain(solution, PiecewiseTerrain.gap(0.3, at=(0.1, 0.0))))
    assert report.penetration < ROUNDING


def test_depth_landing_and_friction_are_those_of_the_normal_under_the_foot():
    solution, ground = stands(), SmoothTerrain(shapes=(Incline(level=0.02, slope_x=0.1),), friction=0.5)
    feet = contact_positions(robots.load("solo12"), solution.q[0])
    report = check(on_terrain(with_meta(solution, friction=[0.5] * 4), ground))
    normal = np.array([-0.1, 0.0, 1.0]) / np.hypot(1.0, 0.1)
    depths = [0.02 + 0.1 * p[0] - p[2] + solo12.RADIUS / normal[2] for p in feet.values()]
    assert report.penetration == pytest.approx(max(depths) * normal[2])
    assert report.landing_height == pytest.approx(max(abs(d) for d in depths[1:]) * normal[2])
    forces = solution.f[:, 1:, :3] / robots.load("solo12").weight
    along = forces @ normal
    margin = 0.5 * along - np.linalg.norm(forces - along[..., None] * normal, axis=-1)
    assert report.friction_margin == pytest.approx(margin.min())


@pytest.mark.parametrize(
    "terrain",
    [
        {"kind": "piecewise"},
        {"kind": "piecewise", "faces": [{}]},
        {"kind": "smooth", "friction": 0.5, "shapes": [3]},
    ],
)
def test_damaged_terrain_of_a_file_is_refused(terrain):
    solution = stands()
    with pytest.raises(SolutionFileError, match="terrain of meta"):
        check(with_meta(solution, terrain=terrain))


# The replay


@pytest.mark.parametrize(
    ("terrain", "drawn"),
    [
        (PiecewiseTerrain.gap(0.3, at=(0.3, 0.0)), {"ground/face0", "ground/face1"}),
        (HILLS, {"ground/smooth", "ground/grid"}),
    ],
    ids=["piecewise", "smooth"],
)
def test_replay_draws_the_ground_as_it_is_described(terrain, drawn, tmp_path):
    scene = shown(on_terrain(stands(), terrain), tmp_path)
    paths = {str(command.get("path", "")).removeprefix("/meshcat/") for command in scene["commands"]}
    assert drawn <= paths
    assert "ground/plane" not in paths


# A motion on smooth ground


@pytest.mark.long
@pytest.mark.parametrize("friction", [FrictionCone(), FrictionPyramid()], ids=["cone", "pyramid"])
def test_a_hop_lands_on_smooth_ground_with_forces_in_the_cone_of_its_normal(friction):
    robot = hopper()
    ground = SmoothTerrain(
        shapes=(Wave(amplitude=0.03, wavelength=0.5, at=(0.02, 0.0)), Incline(slope_y=0.1))
    )
    start, terms = robot.reference.copy(), [t for t in hop().terms if not isinstance(t, FrictionCone)]
    foot = contact_positions(robot, start)[FOOT]
    start[2] += float(ground.height(*foot[:2])) - foot[2]
    problem = hop(
        terrain=ground,
        terms=(*terms, friction, SwingClearance(height=0.02, terrain=ground)),
        initial_q=start,
        guess=lambda t: start,
    )
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    report = check(solution)
    assert report.landing_height < SOLVED
    assert report.friction_margin > -SOLVED
    landed = contact_positions(robot, solution.q[np.flatnonzero(solution.phase == 2)[0]])[FOOT]
    assert landed[2] == pytest.approx(ground.height(*landed[:2]), abs=SOLVED)
