"""The replay: a page that holds all it needs, the right pictures at the right times, the real server."""

import json
import re
import signal
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tests.support.page_meshes import array_of, distance_between, stl_points
from tests.support.processes import LIMIT, ctrl_c_here
from tests.support.replay_pages import objects_of, scene_of, tracks_of
from tests.support.synthetic_motions import Motion, arm_motion, meta_of, sampled, standing, with_meta
from trajopt import InputError, Robot, Solution, replay
from trajopt.motion.configurations import geodesic_configurations
from trajopt.robot import robot_file
from trajopt.robot.data import VisualSource
from trajopt.view.replay import robot as drawn_robot
from trajopt.view.replay.collada import ColladaError
from trajopt.view.replay.commands import ANGLE_ERROR, POSITION_ERROR
from trajopt.view.replay.motion import replay_motion
from trajopt.view.replay.robot import joint_path
from trajopt.view.replay.scene import build_scene
from trajopt.view.replay.show import serve
from trajopt_library import robots

pytestmark = pytest.mark.long

INTERVALS = 6
LIFT, FLIGHT = 0.3, 0.2  # s
VIEWER_SIZE = 0.9e6  # bytes of Meshcat's viewer, in every page
MESH_ERROR = 1e-4  # over a mesh's extent: half of a step along each axis, and a margin
SINGLE_PRECISION = 2e-6  # of lengths and quaternions around one
# The only addresses a page may name: licences of the viewer's parts and the name of XHTML. None is loaded.
NAMED = {"feross.org", "github.com", "kawanet.github.io", "opensource.org", "www.w3.org"}


def lifting(robot: Robot) -> Motion:
    """Solo12 straightens its legs and turns, pushing harder and harder."""
    still, base = np.zeros(robot.nv), standing(robot)

    def q(t: float) -> np.ndarray:
        posture = robot.reference.copy()
        posture[2] += 0.05 * t / LIFT
        posture[3:7] = pin.Quaternion(pin.utils.rotate("z", 0.8 * t / LIFT)).coeffs()
        return posture

    return replace(
        base, duration=LIFT, q=q, v=lambda t: still, a=lambda t: still, f=lambda t: base.f(t) * (1 + 4 * t)
    )


def hovering(robot: Robot) -> Motion:
    return replace(standing(robot), duration=FLIGHT, contacts=(), f=lambda t: np.zeros((4, 6)))


@pytest.fixture(scope="module")
def jump() -> Solution:
    robot = robots.load("solo12")
    return sampled(
        robot, [lifting(robot), hovering(robot)], INTERVALS, visual=robot.visual.to_meta(), problem="<jump>"
    )


@pytest.fixture(scope="module")
def arm() -> Solution:
    robot = robots.load("ur5")
    return sampled(robot, [arm_motion(robot)], INTERVALS, visual=robot.visual.to_meta())


@pytest.fixture(scope="module")
def page(jump, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "jump.html"
    replay(jump, html=path)
    return path.read_text()


def test_page_forbids_and_makes_no_load_from_elsewhere(page):
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1)
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert "*" not in policy
    assert not re.search(r"<(script|link|img|iframe|source)[^>]*\s(src|href)=", page)
    assert not re.search(r"@import|importScripts\(\s*[\"']http|\bimport\(\s*[\"']", page)
    assert set(re.findall(r"https?://([\w.-]+)", page)) <= NAMED


def test_text_of_the_solution_is_escaped_in_the_page(page):
    assert "&lt;jump&gt;" in page
    assert "<jump>" not in page


def test_page_holds_every_mesh_file_once(page, jump):
    scene = scene_of(page)
    files = [stl_points(path) for path in robot_file("solo_description/meshes/stl").rglob("*.stl")]
    held = [array_of(mesh, "position") for mesh in scene["meshes"]]
    # some files are copies of each other
    alike = [
        frozenset(k for k, points in enumerate(files) if distance_between(mesh, points) < MESH_ERROR)
        for mesh in held
    ]
    found = [same for same in alike if same]
    assert len(found) == len(set(found)) == 10
    shown = [path for path in objects_of(scene) if path.startswith("robot/")]
    assert len(shown) == 17


@pytest.mark.parametrize(("name", "limit"), [("jump", 1.0e6), ("arm", 2.5e6)])
def test_page_is_small(name, limit, request, tmp_path):
    shown = replay(request.getfixturevalue(name), html=tmp_path / "page.html")
    assert shown.size == (tmp_path / "page.html").stat().st_size
    assert shown.size < VIEWER_SIZE + limit


@pytest.mark.parametrize(("speed", "frames"), [(1.0, 31), (0.25, 121), (2.0, 16)])
def test_animation_has_sixty_frames_a_second_of_playback(jump, tmp_path, speed, frames):
    shown = replay(jump, html=tmp_path / "page.html", speed=speed)
    assert shown.frames == frames
    assert shown.duration == pytest.approx((LIFT + FLIGHT) / speed)
    scene = scene_of((tmp_path / "page.html").read_text())
    assert {len(rows) for rows in tracks_of(scene).values()} == {frames}
    message = next(command for command in scene["commands"] if command["type"] == "set_animation")
    for animation in message["animations"]:
        assert (frames - 1) / animation["clip"]["fps"] == pytest.approx(shown.duration, rel=1e-6)


def test_every_joint_is_placed_as_by_forward_kinematics_within_the_stated_error(page, jump):
    tracks, model = tracks_of(scene_of(page)), jump.model
    data, extent = model.createData(), build_scene([jump], [replay_motion(jump)]).facts["size"]
    # thinned, and then rounded to a multiple of an eighth of the error
    allowed = POSITION_ERROR * extent * (1 + np.sqrt(3) / 16) + SINGLE_PRECISION
    for row, time in enumerate(np.linspace(0, LIFT + FLIGHT, 31)):
        pin.forwardKinematics(model, data, geodesic_configurations(jump, time))
        for joint in range(1, model.njoints):
            position = tracks[joint_path(model, joint), "position"][row]
            turn = pin.Quaternion(tracks[joint_path(model, joint), "quaternion"][row])
            assert np.linalg.norm(position - data.oMi[joint].translation) <= allowed
            error = pin.log3(turn.toRotationMatrix().T @ data.oMi[joint].rotation)
            assert np.linalg.norm(error) <= ANGLE_ERROR * (1 + 1 / 4)  # a turn is twice its quaternion's


def test_arrows_are_proportional_to_force_over_weight_and_hidden_in_flight(page, jump):
    tracks = tracks_of(scene_of(page))
    motion = replay_motion(jump)
    flying = ~motion.active.any(axis=1)
    assert 0 < flying.sum() < len(flying)
    lengths, forces = [], []
    for contact, frame in enumerate(jump.contact_frames):
        visible = tracks[f"forces/{frame}", "visible"][:, 0].astype(bool)
        np.testing.assert_array_equal(visible, ~flying)
        neck = tracks[f"forces/{frame}/head", "position"][visible, 2]
        scale = tracks[f"forces/{frame}/head", "scale"][visible, 0]
        lengths.append(np.column_stack([neck, scale]))
        forces.append(np.linalg.norm(motion.force[visible, contact], axis=1))
    lengths, forces = np.concatenate(lengths), np.concatenate(forces)
    # length = neck + scale * head for one head length, and force * constant
    head, constant = np.linalg.lstsq(np.column_stack([lengths[:, 1], -forces]), -lengths[:, 0], rcond=None)[0]
    np.testing.assert_allclose(lengths[:, 0] + head * lengths[:, 1], constant * forces, atol=1e-5)
    assert constant > 0
    assert head > 0


def test_ground_lies_under_the_visible_feet_not_under_the_frames_inside_them(page):
    plane = next(
        command
        for command in scene_of(page)["commands"]
        if command["type"] == "set_transform" and command["path"].endswith("ground/plane")
    )
    assert plane["matrix"][14] == pytest.approx(0.0, abs=0.003)  # not at the frames, 16 mm higher


def test_arm_is_drawn_whole_and_in_the_colours_of_its_files(arm, tmp_path):
    replay(arm, html=tmp_path / "arm.html")
    scene = scene_of((tmp_path / "arm.html").read_text())
    drawn = {path: content for path, content in objects_of(scene).items() if path.startswith("robot/")}
    assert len(drawn) == 7
    for content in drawn.values():
        mesh = scene["meshes"][content["geometries"][0]["shared"]]
        colours = array_of(mesh, "color")
        assert len(np.unique(colours, axis=0)) > 1


def test_collada_file_that_cannot_be_read_is_drawn_from_pinocchios_mesh(arm, tmp_path, monkeypatch):
    def refuse(path: str, plain: np.ndarray) -> None:
        raise ColladaError("skins are not read")

    monkeypatch.setattr(drawn_robot, "read_collada", refuse)

    assert replay(arm, html=tmp_path / "arm.html").note == ""
    objects = objects_of(scene_of((tmp_path / "arm.html").read_text()))
    assert sum(path.startswith("robot/") for path in objects) == 7


@pytest.mark.parametrize(
    ("visual", "said"),
    [
        (None, "names no URDF"),
        ({"urdf": "/nowhere/robot.urdf", "package_dirs": []}, "/nowhere/robot.urdf"),
        (
            {
                "urdf": "example-robot-data/robots/solo_description/robots/solo12.urdf",
                "package_dirs": ["/nowhere"],
            },
            "mesh",
        ),
    ],
)
def test_robot_without_meshes_is_drawn_as_a_skeleton_and_one_line_says_so(
    jump, tmp_path, capsys, visual, said
):
    shown = replay(with_meta(jump, visual=visual), html=tmp_path / "page.html")
    assert "skeleton" in shown.note
    assert said in shown.note
    assert capsys.readouterr().err == shown.note + "\n"
    objects = objects_of(scene_of((tmp_path / "page.html").read_text()))
    balls = [path for path in objects if path.startswith("robot/") and path.endswith("/joint")]
    rods = [path for path in objects if path.startswith("robot/") and "/rod" in path]
    assert len(balls) == jump.model.njoints - 1
    assert len(rods) >= 12


def test_unsolved_solution_says_so_in_the_page(jump, tmp_path):
    replay(with_meta(jump, success=False, status="iteration limit"), html=tmp_path / "page.html")
    assert "not solved: iteration limit" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_speed_that_is_not_positive_is_refused(jump, tmp_path, speed):
    with pytest.raises(
        InputError, match=r"^speed (is|of replay is) .*; allowed: (> 0 to 1000|a finite number)"
    ):
        replay(jump, html=tmp_path / "page.html", speed=speed)


def test_page_that_cannot_be_written_is_refused_by_name(jump, tmp_path):
    with pytest.raises(InputError, match=r"nowhere.page\.html"):
        replay(jump, html=tmp_path / "nowhere" / "page.html")


def test_solution_read_from_its_file_is_replayed_the_same(jump, tmp_path):
    loaded = Solution.load(jump.save(tmp_path / "jump.npz"))
    first, second = (replay(entry, html=tmp_path / "page.html") for entry in (jump, loaded))
    assert (first.frames, first.note) == (second.frames, second.note)


def test_live_server_shows_the_scene_until_interrupted(jump, capsys):
    shown = replay(jump, open_browser=False)
    try:
        assert capsys.readouterr().out == f"replay at {shown.url}\n"
        with urllib.request.urlopen(shown.url, timeout=LIMIT) as answer:
            assert b"MeshCat" in answer.read()
        told = shown.window.get_scene()
        assert told.count("handle_command_bytearray(new") >= 17
        with ctrl_c_here():
            serve(shown, lambda: signal.raise_signal(signal.SIGINT))
        assert shown.window.server_proc.poll() is not None
    finally:
        shown.close()


def test_serving_a_page_returns_at_once(jump, tmp_path):
    shown = replay(jump, html=tmp_path / "page.html")
    serve(shown)
    assert shown.window is None


def test_meta_of_the_solution_is_enough_to_find_the_meshes(jump):
    assert not Path(jump.meta["visual"]["urdf"]).is_absolute()
    assert VisualSource.from_meta(json.loads(json.dumps(jump.meta["visual"]))) == jump.description.visual
    assert "visual" not in meta_of(robots.load("solo12"))
