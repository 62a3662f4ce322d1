"""Shapes of the wrong size, pairs that overlap, and files that cannot be read, are said in one line each."""

import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshcat
import pytest

from trajopt.collision.description import RobotShapes, robot_shapes
from trajopt.collision.shapes import LinkShape
from trajopt.errors import InputError
from trajopt.inspection.report import robot_report
from trajopt.robot.geometry import mesh_vertices
from trajopt.robot.robot import Robot
from trajopt.view.replay.commands import Recorder
from trajopt.view.replay.robot import draw_robot
from trajopt_library import robots

LINK = """
  <link name="l{k}">
    <inertial><mass value="1"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>
    <collision><origin xyz="0 0 0.15"/><geometry>{shape}</geometry></collision>
    <visual><origin xyz="0 0 0.15"/><geometry>{shape}</geometry></visual>
  </link>"""
JOINT = """
  <joint name="j{k}" type="revolute"><parent link="l{before}"/><child link="l{k}"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="50" velocity="3"/></joint>"""
BAR = '<cylinder length="0.25" radius="0.03"/>'


def arm(folder: Path, mesh: str) -> Robot:
    """An arm of five links of 0.3 m, the fourth with a mesh."""
    links = [LINK.format(k=k, shape=mesh if k == 3 else BAR) for k in range(5)]
    joints = [JOINT.format(k=k, before=k - 1) for k in range(1, 5)]
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="arm">{"".join(links + joints)}</robot>')
    return Robot.from_urdf(file, base="fixed")


def write_bar(file: Path, unit: float) -> None:
    """A binary STL file of a thin bar of 0.2 m along z, in units of which a metre has so many."""
    half, length = 0.01 * unit, 0.1 * unit
    corners = [(-half, -half, -length), (half, -half, -length), (0, half, -length), (0, 0, length)]
    faces = [(0, 1, 2), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
    triangles = [struct.pack("<12fH", 0, 0, 0, *(x for k in face for x in corners[k]), 0) for face in faces]
    file.write_bytes(b" " * 80 + struct.pack("<I", len(faces)) + b"".join(triangles))


@pytest.mark.parametrize(("unit", "scale"), [(1.0, ""), (1000.0, 'scale="0.001 0.001 0.001"')])
def test_meshes_in_metres_are_not_doubted(unit: float, scale: str, tmp_path: Path) -> None:
    write_bar(tmp_path / "bar.stl", unit)
    robot = arm(tmp_path, f'<mesh filename="bar.stl" {scale}/>')
    assert robot_shapes(robot).doubts(robot.model) == ()


def test_meshes_in_millimetres_are_doubted_and_so_are_pairs_that_they_lose(tmp_path: Path) -> None:
    write_bar(tmp_path / "bar.stl", 1000.0)
    robot = arm(tmp_path, '<mesh filename="bar.stl"/>')
    size, pairs = robot_shapes(robot).doubts(robot.model)
    assert "times as large as the robot's reach, 0.9 m: l3" in size
    assert 'scale="0.001 0.001 0.001"' in size
    assert pairs.startswith("2 of 6 pairs of shapes (33 %) are not judged")
    warnings = robot_report(robot).warnings
    assert size in warnings
    assert pairs in warnings


@pytest.mark.long
@pytest.mark.parametrize("name", robots.names())
def test_no_robot_of_the_library_is_doubted(name: str) -> None:
    robot = robots.load(name)
    assert robot_shapes(robot).doubts(robot.model) == ()


def test_many_shapes_are_counted_not_all_named() -> None:
    robot = robots.load("hopper")
    frame = robot.contacts[0].frame
    shapes = tuple(LinkShape.sphere(f"ball{k}", frame, (0, 0, 0), 10.0 + k) for k in range(5))
    (line,) = RobotShapes(shapes=shapes).doubts(robot.model)
    assert "ball4, ball3, ball2, ..." in line


@pytest.mark.parametrize(
    ("name", "content", "cause"),
    [
        ("empty.stl", b"", "File is empty"),
        ("broken.dae", b"<COLLADA>", "malformed XML"),
        ("other.foo", b"a", "No suitable reader found"),
        ("lost.stl", None, "No such file"),
    ],
)
def test_a_mesh_that_cannot_be_read_is_named_with_the_cause(
    name: str, content: bytes | None, cause: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"mesh file .*{name} cannot be read: .*{cause}") as refused:
        mesh_vertices(tmp_path / name, (1.0, 1.0, 1.0))
    for word in ("\n", "/project/", "Hint", "Could not load"):
        assert word not in str(refused.value)


def test_a_report_and_a_replay_name_the_mesh_that_they_are_without(tmp_path: Path) -> None:
    (tmp_path / "empty.stl").write_bytes(b"")
    robot = arm(tmp_path, '<mesh filename="empty.stl"/>')
    assert robot_shapes(robot).missing == (
        f"l3_0: mesh file {tmp_path / 'empty.stl'} cannot be read: File is empty",
    )
    text = robot_report(robot).table()
    assert "4 shapes to draw" in text
    assert f"a replay draws not all: mesh file {tmp_path / 'empty.stl'} cannot be read" in text
    assert "empty.stl cannot be read: File is empty" in text
    assert "/project/" not in text
    described = SimpleNamespace(visual=robot.visual, robot=robot.name)
    plan: Any = SimpleNamespace(description=described, model=robot.model)
    drawn = draw_robot(meshcat.Visualizer(window=Recorder()), plan)
    assert "without meshes: l3_0 (mesh file" in drawn.note
    assert drawn.note.endswith("cannot be read: File is empty)")
