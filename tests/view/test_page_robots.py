"""Pages of all robots have all parts; in Chromium those of each kind are where they belong."""

import itertools
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from tests.support.browser import (
    WORLD,
    boxes,
    drawn_by,
    extent,
    in_motion,
    pixels_of,
    until,
)
from tests.support.page_meshes import array_of
from tests.support.replay_pages import objects_of, scene_of
from trajopt import Robot, Solution, replay
from trajopt.motion.configurations import geodesic_configurations
from trajopt.view.replay.collada import ColladaError, read_collada
from trajopt.view.replay.robot import joint_path
from trajopt_library import robots

SIZE = (320, 240)
# Robots that have parts of all kinds, see `kinds_of`.
IN_BROWSER = {
    "a1": {".dae", "Box", "Sphere"},
    "hyq": {".dae", "Box", "Cylinder", "Sphere"},
    "laikago": {".obj", "Sphere"},
    "panda": {".dae"},
    "talos": {".stl", "mirrored", "Box", "Cylinder"},
    "hopper": {"skeleton"},
    "irb1600": {"skeleton"},
}
TIME = 1 / 6  # s, of a frame at 60 a second: one with feet stands, and its joints have moved
# Of the robot's extent: a page leaves frames out where that moves a joint by at most 2e-4 of it and turns it
# by 5e-4 rad, and rounds the vertices of a mesh.
PLACE = 8e-4
# Points on a circle that spans a round part, and on a sphere: 1e-3 and 5e-3 of its radius.
CIRCLE, SPHERE = 64, 400
# Pixels: a silhouette ends on a pixel's edge and is drawn smooth.
EDGE = 2.0
COLOURS = """path => {%s
    const found = new Set();
    at(path).traverse(mesh => {
        const colours = mesh.isMesh && mesh.geometry.attributes.color;
        const whole = colours && (colours.normalized ? 1 : 255), part = get => Math.round(whole * get);
        for (let k = 0; colours && k < colours.count; k++) {
            const [red, green, blue] = [colours.getX(k), colours.getY(k), colours.getZ(k)].map(part);
            found.add(65536 * red + 256 * green + blue);
        }
    });
    return [...found];
}"""


def part_path(robot: Robot, part: pin.GeometryObject) -> str:
    return f"{joint_path(robot.model, part.parentJoint)}/{part.name.replace('/', '_')}"


def surface_points(shape: object) -> np.ndarray:
    """Points (k, 3) that span a part, as Pinocchio's own reader of meshes gives them."""
    if isinstance(shape, coal.BVHModelBase):
        return np.asarray(shape.vertices())
    turn = np.linspace(0, 2 * np.pi, CIRCLE)
    if isinstance(shape, coal.Sphere):
        height = np.linspace(-1, 1, SPHERE)[:, None]
        turn = np.pi * (1 + 5**0.5) * np.arange(SPHERE)[:, None]
        level = np.sqrt(1 - height**2)
        return shape.radius * np.hstack([level * np.cos(turn), level * np.sin(turn), height])
    if isinstance(shape, coal.Cylinder):
        rim = shape.radius * np.column_stack([np.cos(turn), np.sin(turn)])
        return np.vstack([np.insert(rim, 2, side * shape.halfLength, axis=1) for side in (-1, 1)])
    assert isinstance(shape, coal.Box), shape
    return np.array(list(itertools.product((-1, 1), repeat=3))) * shape.halfSide


def world_points(robot: Robot, parts: list, solution: Solution, t: float) -> dict[str, np.ndarray]:
    """Points (k, 3) of every part in the world at ``t``, by numeric kinematics."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, geodesic_configurations(solution, t))
    placed = {}
    for part in parts:
        place = data.oMi[part.parentJoint] * part.placement
        placed[part_path(robot, part)] = surface_points(part.geometry) @ place.rotation.T + place.translation
    return placed


def joint_positions(robot: Robot, solution: Solution, t: float) -> np.ndarray:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, geodesic_configurations(solution, t))
    return np.array([data.oMi[joint].translation for joint in range(1, robot.model.njoints)])


def kinds_of(robot: Robot) -> set[str]:
    """Endings of mesh files and names of shapes; "mirrored" with a mesh that is."""
    if robot.visual is None:
        return {"skeleton"}
    parts = robot.visual.geometry(robot.model).geometryObjects
    mirrored = {"mirrored" for part in parts if (np.asarray(part.meshScale) < 0).any()}
    return mirrored | {Path(part.meshPath).suffix.lower() or type(part.geometry).__name__ for part in parts}


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(set(robots.names()) - set(IN_BROWSER)))
def test_page_of_every_robot_has_all_its_parts_in_their_size(name, tmp_path):
    robot = robots.load(name)
    assert kinds_of(robot) <= set.union(*IN_BROWSER.values())
    shown = replay(in_motion(robot), html=tmp_path / "page.html")
    scene = scene_of(shown.html.read_text())
    drawn = {path: content for path, content in objects_of(scene).items() if path.startswith("robot/")}
    if robot.visual is None:
        assert "skeleton" in shown.note
        assert sum(path.endswith("/joint") for path in drawn) == robot.model.njoints - 1
        return
    assert not shown.note
    parts = {part_path(robot, part): part for part in robot.visual.geometry(robot.model).geometryObjects}
    assert drawn.keys() == parts.keys()
    for path, part in parts.items():
        if isinstance(part.geometry, coal.BVHModelBase):
            held = (
                array_of(scene["meshes"][drawn[path]["geometries"][0]["shared"]], "position") * part.meshScale
            )
            points = surface_points(part.geometry)
            expected, size = np.array([points.min(axis=0), points.max(axis=0)]), np.ptp(points, axis=0).max()
            box = [held.min(axis=0), held.max(axis=0)]
            np.testing.assert_allclose(box, expected, atol=PLACE * size, err_msg=path)


@pytest.mark.long
@pytest.mark.parametrize("name", IN_BROWSER)
def test_page_opens_and_plays_without_complaint_and_shows_all_parts(browser, name, tmp_path):
    robot = robots.load(name)
    assert kinds_of(robot) == IN_BROWSER[name]
    solution = in_motion(robot)
    shown = replay(solution, html=tmp_path / "page.html")
    with browser.opened(shown.html, SIZE, f"t={TIME}&camera=overview&bare") as view:
        if robot.visual is None:
            assert "skeleton" in shown.note
            centres = joint_positions(robot, solution, TIME)
            left_top, right_bottom = extent(drawn_by(view, "robot"))
            pixels = pixels_of(view, centres, SIZE)
            assert (pixels > left_top - EDGE).all()
            assert (pixels < right_bottom + EDGE).all()
        else:
            assert not shown.note
            expect_parts(view, robot, solution)
        view.evaluate("trajopt.play()")
        until(view, f"trajopt.state().playing && trajopt.state().time > {TIME + 0.01}")
        assert view.errors == []
        assert [address for address in view.requests if not address.startswith(("file:", "blob:"))] == []


def expect_parts(view, robot: Robot, solution: Solution) -> None:
    parts = list(robot.visual.geometry(robot.model).geometryObjects)
    placed = world_points(robot, parts, solution, TIME)
    cloud = np.concatenate(list(placed.values()))
    size = float(np.ptp(cloud, axis=0).max())
    found = boxes(view, list(placed))
    assert found.shape == (len(placed), 2, 3)
    for (path, points), box in zip(placed.items(), found, strict=True):
        expected = np.array([points.min(axis=0), points.max(axis=0)])
        np.testing.assert_allclose(box, expected, atol=PLACE * size, err_msg=path)
    for part in parts:
        if part.meshPath.lower().endswith(".dae"):
            expect_colours(view, part_path(robot, part), part)
    silhouette = pixels_of(view, cloud, SIZE)
    expected = np.array([silhouette.min(axis=0), silhouette.max(axis=0)])
    np.testing.assert_allclose(extent(drawn_by(view, "robot")), expected, atol=EDGE)


def expect_colours(view, path: str, part: pin.GeometryObject) -> None:
    try:
        mesh = read_collada(part.meshPath, np.asarray(part.meshColor)[:3])
    except ColladaError:
        return
    used = np.unique(mesh.triangles)
    expected = {int(r) << 16 | int(g) << 8 | int(b) for r, g, b in np.round(255 * mesh.colours[used])}
    assert set(view.evaluate(COLOURS % WORLD, path)) == expected, path
