"""The ground, walls, steps and handles of a replay lie where the robot touches them."""

from dataclasses import replace

import meshcat
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.models import placement
from tests.support.replay_pages import flying, objects_of, on_surface, placements_of, shown
from tests.support.synthetic_motions import Motion, arm_motion, sampled, with_meta
from trajopt import Solution, replay
from trajopt.errors import SolutionFileError
from trajopt.terrain import Patch, PiecewiseTerrain, Surface
from trajopt.view.replay.commands import Recorder
from trajopt.view.replay.ground import GRID_LIFT
from trajopt.view.replay.motion import replay_motion
from trajopt.view.replay.runs import drawn_runs
from trajopt.view.replay.surfaces import PATCH_MARGIN, THICKNESS
from trajopt_library import robots
from trajopt_library.robots import solo12

INTERVALS, FOOT = 3, "FL_FOOT"
SQUARE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
SINGLE_PRECISION = 2e-6  # of lengths around one
PROBES = 0.03  # a sphere's extent, over its radius, from evenly spread points


def turned(solution: Solution, turn: np.ndarray, shift: np.ndarray) -> Solution:
    """The same motion with the world moved by a rotation and a shift, terrain and forces with it."""
    q, f = solution.q.copy(), solution.f.copy()
    q[:, :3] = q[:, :3] @ turn.T + shift
    q[:, 3:7] = [pin.Quaternion(turn @ pin.Quaternion(row).toRotationMatrix()).coeffs() for row in q[:, 3:7]]
    f[..., :3], f[..., 3:] = f[..., :3] @ turn.T, f[..., 3:] @ turn.T
    normal = turn[:, 2]
    terrain = {
        "kind": "flat",
        "height": float(normal @ shift / normal[2]),
        "normal": normal.tolist(),
        "friction": 0.7,
    }
    return replace(with_meta(solution, terrain=terrain), q=q, f=f)


def foot_at(solution: Solution, frame: str = FOOT) -> np.ndarray:
    return placement(solution.model, solution.q[0], frame).translation.copy()


def surfaces_shown(scene: dict) -> list[str]:
    return sorted(path for path in objects_of(scene) if path.startswith("surfaces/"))


def grid_points(scene: dict) -> np.ndarray:
    found = []
    for path, content in objects_of(scene).items():
        if path in ("ground/grid", "ground/bold"):
            mesh = scene["meshes"][content["geometries"][0]["shared"]]
            found.append(np.frombuffer(mesh["attributes"]["position"]["array"].data, np.float32))
    return np.concatenate(found).reshape(-1, 3)


# Ground


@pytest.mark.long
@pytest.mark.parametrize(("axis", "angle"), [("x", 0.4), ("y", -0.35), ("y", 1.2)])
def test_ground_moves_with_a_world_that_is_tilted(hop, tmp_path, axis, angle):
    turn, shift = pin.utils.rotate(axis, angle), np.array([0.3, -0.2, 0.5])
    level = placements_of(shown(hop, tmp_path))["ground/plane"]
    scene = shown(turned(hop, turn, shift), tmp_path)
    plane = placements_of(scene)["ground/plane"]
    assert_allclose(plane[:3, 2], turn[:, 2], atol=SINGLE_PRECISION)
    depth = (plane[:3, 3] - shift) @ turn[:, 2]
    # the robot's extent, which sets how far the plane lies below the grid, is measured along world axes
    assert depth == pytest.approx(level[2, 3], abs=GRID_LIFT)
    assert depth == pytest.approx(0.0, abs=0.003)  # the tips' radius below their frames
    above = (grid_points(scene) - plane[:3, 3]) @ turn[:, 2]
    assert np.ptp(above) < 10 * SINGLE_PRECISION  # of a grid some metres wide
    assert 0 < above.mean() < 0.01


def test_ground_without_stance_is_the_terrain(hop, tmp_path):
    robot = robots.load("solo12")
    floating = sampled(robot, [flying(robot)], INTERVALS, visual=None)
    tilted = {"kind": "flat", "height": 0.5, "normal": [0.6, 0.0, 0.8], "friction": 0.7}
    for terrain, normal, height in ((None, [0, 0, 1], 0.0), (tilted, [0.6, 0, 0.8], 0.4)):
        plane = placements_of(shown(with_meta(floating, terrain=terrain), tmp_path))["ground/plane"]
        assert_allclose(plane[:3, 2], normal, atol=SINGLE_PRECISION)
        assert plane[:3, 3] @ normal == pytest.approx(height, abs=0.005)


@pytest.mark.long
@pytest.mark.parametrize("height", [None, -1.1])
def test_an_arm_stands_on_its_floor_wherever_ground_is_that_it_does_not_touch(tmp_path, height):
    robot = robots.load("panda")
    motion = sampled(robot, [arm_motion(robot)], INTERVALS, visual=robot.visual.to_meta())
    flat = {"kind": "flat", "height": height, "normal": [0.0, 0.0, 1.0], "friction": 0.7}
    scene = shown(with_meta(motion, terrain=height and flat), tmp_path)
    assert placements_of(scene)["ground/plane"][2, 3] == pytest.approx(0.0, abs=0.005)


def test_the_floor_below_a_pendulum_is_as_low_as_it_hangs(tmp_path):
    robot = robots.load("double_pendulum")
    hanging = pin.integrate(robot.model, pin.neutral(robot.model), np.array([np.pi, 0.0]))
    still, none = np.zeros(2), np.zeros((0, 6))
    rest = {name: lambda t: still for name in ("v", "a", "tau")}
    motion = Motion(duration=0.3, contacts=(), q=lambda t: hanging, f=lambda t: none, **rest)
    solution = sampled(robot, [motion], INTERVALS, visual=robot.visual.to_meta())
    vis, moved = meshcat.Visualizer(window=Recorder()), [replay_motion(solution)]
    lowest = drawn_runs(vis, [solution], moved, "overlaid", None)[0].cloud[:, 2].min()
    assert lowest < -0.1
    assert placements_of(shown(solution, tmp_path))["ground/plane"][2, 3] == pytest.approx(lowest, abs=0.005)


def test_faces_of_one_plane_which_may_overlap_have_one_colour(hop, tmp_path):
    faces = [
        Patch(
            surface=Surface(point=np.array([0.0, 0.0, height]), normal=np.array([0.0, 0.0, 1.0])),
            vertices=np.array(SQUARE) + np.array([x, 0.0, height]),
            name=f"face {x}",
        )
        for x, height in ((0.0, 0.0), (0.5, 0.0), (1.0, 0.1))
    ]
    terrain = PiecewiseTerrain(faces=tuple(faces))
    scene = shown(with_meta(hop, terrain=terrain.describe()), tmp_path)
    colours = []
    for number in range(3):
        content = objects_of(scene)[f"ground/face{number}"]
        mesh = scene["meshes"][content["geometries"][0]["shared"]]
        colours.append(bytes(mesh["attributes"]["color"]["array"].data)[:3])
    assert colours[0] == colours[1] != colours[2]


@pytest.mark.parametrize("normal", [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
def test_ground_that_does_not_face_upwards_is_refused(bones, normal):
    terrain = {"kind": "flat", "height": 0.0, "normal": normal, "friction": 0.7}
    with pytest.raises(SolutionFileError, match=r"terrain of meta: normal .*upwards"):
        with_meta(bones, terrain=terrain)


def test_terrain_of_an_unknown_kind_is_refused(hop, tmp_path):
    with pytest.raises(SolutionFileError, match="stairs"):
        replay(with_meta(hop, terrain={"kind": "stairs"}), html=tmp_path / "page.html")


def test_camera_travels_along_a_slope_and_not_with_a_hop_from_it(bones, tmp_path):
    turn = pin.utils.rotate("y", -0.3)
    far, high = bones.q.copy(), bones.q.copy()
    far[:, 0] += 5 * bones.t / bones.t[-1]
    high[:, 2] += 5 * np.sin(np.pi * bones.t / bones.t[-1])
    moved = [turned(replace(bones, q=q), turn, np.zeros(3)) for q in (far, high)]
    shown = [replay(solution, html=tmp_path / "page.html") for solution in moved]
    assert [entry.facts["travels"] for entry in shown] == [True, False]


# Walls and handles


@pytest.mark.parametrize(
    ("normal", "before"),
    [((-1.0, 0.0, 0.2), True), ((0.3, 0.1, 1.0), True), ((0.6, 0.8, 0.0), False), ((0.0, 0.2, -1.0), False)],
)
def test_wall_is_a_board_behind_the_drawn_tip_of_a_leg_before_it(bones, tmp_path, normal, before):
    place = foot_at(bones)
    touched = place - solo12.RADIUS * np.array(normal) / np.linalg.norm(normal)
    wall = Surface(point=touched + np.cross(normal, [0.3, 0.7, 0.2]), normal=np.array(normal))
    scene = shown(on_surface(bones, {FOOT: wall}, {}, {FOOT: wall}), tmp_path)
    assert surfaces_shown(scene) == ["surfaces/patch0"]
    matrix, board = placements_of(scene)["surfaces/patch0"], objects_of(scene)["surfaces/patch0"]
    size = board["geometries"][0]
    assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=SINGLE_PRECISION)
    assert_allclose(matrix[:3, 2], wall.normal, atol=SINGLE_PRECISION)
    front = matrix[:3, 3] + size["depth"] / 2 * wall.normal
    spheres = [content["geometries"][0] for path, content in objects_of(scene).items() if "/tip" in path]
    radius = spheres[0]["radius"]
    # The drawn tip is larger than the contact's ball; a leg that reaches through the wall leaves it in place.
    depth = max(radius, solo12.RADIUS) if before else solo12.RADIUS
    assert_allclose(front, place - depth * wall.normal, atol=PROBES * radius)  # centred on the one contact
    extent = size["depth"] / THICKNESS
    assert_allclose([size["width"], size["height"]], 2 * PATCH_MARGIN * extent, rtol=SINGLE_PRECISION)
    assert 0 < board["materials"][0]["opacity"] < 1


def test_contacts_on_one_plane_share_a_board_that_reaches_beyond_them(bones, tmp_path):
    feet = {frame: foot_at(bones, frame) for frame in ("FL_FOOT", "HL_FOOT")}
    wall = Surface(point=feet["FL_FOOT"], normal=np.array([0.0, -1.0, 0.0]))
    scene = shown(on_surface(bones, {"FL_FOOT": wall}, {}, {"HL_FOOT": wall}), tmp_path)
    assert surfaces_shown(scene) == ["surfaces/patch0"]
    matrix = placements_of(scene)["surfaces/patch0"]
    size = objects_of(scene)["surfaces/patch0"]["geometries"][0]
    half = np.array([size["width"], size["height"]]) / 2
    for place in feet.values():
        local = matrix[:3, :3].T @ (place - matrix[:3, 3])
        assert np.all(np.abs(local[:2]) < half)
    edge = matrix[:3, 0]
    assert edge[2] == pytest.approx(0.0, abs=SINGLE_PRECISION)  # a wall's first edge is horizontal
    assert 2 * half[0] < abs(edge @ (feet["FL_FOOT"] - feet["HL_FOOT"])) + 0.3


def test_surface_in_the_terrains_plane_is_the_ground(bones, tmp_path):
    same = Surface(point=np.array([3.0, -2.0, 0.0]), normal=np.array([0.0, 0.0, 2.0]), friction=0.1)
    scene, plain = (
        shown(entry, tmp_path) for entry in (on_surface(bones, {FOOT: same}, {}, {FOOT: same}), bones)
    )
    assert surfaces_shown(scene) == []
    assert_allclose(placements_of(scene)["ground/plane"], placements_of(plain)["ground/plane"])


def test_foot_on_a_step_below_does_not_lower_the_ground(bones, tmp_path):
    lower = foot_at(bones) - [0, 0, 0.1]
    step = Surface(point=lower, normal=np.array([0.0, 0.0, 1.0]))
    model, q = bones.model, bones.q.copy()
    knee = model.joints[model.getJointId("FL_KFE")].idx_q
    q[:, knee] *= 0.6  # straightens the leg: its foot goes below the others
    stepped = on_surface(replace(bones, q=q), {FOOT: step}, {}, {FOOT: step})
    assert foot_at(stepped)[2] < foot_at(bones)[2] - 0.02
    ground, plain = (placements_of(shown(entry, tmp_path))["ground/plane"] for entry in (stepped, bones))
    assert ground[2, 3] == pytest.approx(plain[2, 3], abs=0.001)


def test_held_contact_has_a_disc_of_another_colour_at_its_place(bones, tmp_path):
    place, direction = foot_at(bones), np.array([-0.6, 0.0, 0.8])
    handle = Surface(point=place, normal=direction, bilateral=True)
    wall = Surface(point=foot_at(bones, "HR_FOOT"), normal=np.array([0.0, 1.0, 0.0]))
    scene = shown(on_surface(bones, {FOOT: handle, "HR_FOOT": wall}, {}, {FOOT: handle}), tmp_path)
    assert surfaces_shown(scene) == ["surfaces/handle0", "surfaces/patch0"]
    matrix, disc = placements_of(scene)["surfaces/handle0"], objects_of(scene)["surfaces/handle0"]
    size = disc["geometries"][0]
    assert_allclose(matrix[:3, 1], direction, atol=SINGLE_PRECISION)  # a cylinder lies along its y axis
    touched = place - solo12.RADIUS * direction
    assert_allclose(matrix[:3, 3] + size["height"] / 2 * direction, touched, atol=SINGLE_PRECISION)
    board = objects_of(scene)["surfaces/patch0"]
    assert disc["materials"][0]["color"] != board["materials"][0]["color"]


def test_handle_on_the_ground_is_shown_and_bears_no_ground(bones, tmp_path):
    bolt = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), bilateral=True)
    scene = shown(on_surface(bones, {FOOT: bolt}, {}, {}), tmp_path)
    assert surfaces_shown(scene) == ["surfaces/handle0"]
