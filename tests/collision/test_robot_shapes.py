"""Shapes of every robot enclose its geometry; doubtful ones are said in one line each."""

import inspect
import shutil
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import coal
import meshcat
import numpy as np
import pinocchio as pin
import pytest

from tests.support.repository import ROOT
from trajopt import FlatGround, InputError, Robot
from trajopt.collision import CollisionScene, inertia_boxes, robot_shapes
from trajopt.collision.coal_shapes import coal_link
from trajopt.collision.description import RobotShapes, sampled_postures
from trajopt.collision.hulls import MOST_EXCESS
from trajopt.collision.shapes import LinkShape
from trajopt.inspection.report import robot_report
from trajopt.robot.geometry import mesh_vertices
from trajopt.view.replay.commands import Recorder
from trajopt.view.replay.robot import draw_robot
from trajopt_library import robots

# Points are rounded to 1e-6 m, and hulls are larger by at least that.
ROUNDING = 3e-6
# Meshes in single precision, and points that Coal's distances are exact to.
EXCESS = MOST_EXCESS + 1e-5
WITHOUT_GEOMETRY = {"hopper", "hopper_space", "irb1600"}
PUPPY = ROOT / "docs" / "tutorial" / "puppy" / "urdf" / "puppy.urdf"


def outside(robot: Robot, found: RobotShapes, link: str, points: np.ndarray) -> np.ndarray:
    """How far points (n, 3), m, of the world at the reference are outside of the nearest shape of a link."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, robot.reference)
    best = np.full(len(points), np.inf)
    for shape in found.shapes:
        if shape.name != link and shape.name.rpartition("_")[0] != link:
            continue
        solid, place = coal_link(shape)
        there = data.oMf[model.getFrameId(shape.frame)] * place
        here, point = coal.Transform3s(there.rotation, there.translation), coal.Transform3s()
        for index, position in enumerate(points):
            point.setTranslation(position)
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            best[index] = min(
                best[index], coal.distance(solid, here, coal.Sphere(1e-9), point, request, result)
            )
    return best


@pytest.mark.long
@pytest.mark.parametrize("name", ["solo12", "go2", "talos", "bolt", "ur5", "panda", "anymal_c"])
def test_every_point_of_the_description_is_in_a_shape_of_its_link(name):
    robot = robots.load(name)
    model, data, found = robot.model, robot.model.createData(), robot_shapes(robot)
    pin.framesForwardKinematics(model, data, robot.reference)
    geometry = robot.visual.geometry(model, pin.GeometryType.COLLISION)
    assert not found.missing
    assert len(found.shapes) == geometry.ngeoms
    for entry in geometry.geometryObjects:
        shape = entry.geometry
        if isinstance(shape, coal.BVHModelBase):
            points = np.array(shape.vertices())[:: max(1, shape.num_vertices // 200)]
        elif isinstance(shape, coal.Cylinder):
            angle = np.linspace(0, 2 * np.pi, 40)
            ring = shape.radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
            points = np.concatenate([ring + np.array([0, 0, side * shape.halfLength]) for side in (-1, 1)])
        else:
            shape.computeLocalAABB()
            points = shape.aabb_local.center()[None]
        place = data.oMi[entry.parentJoint] * entry.placement
        world = points @ place.rotation.T + place.translation
        link = model.frames[entry.parentFrame].name
        assert outside(robot, found, link, world).max() < ROUNDING, entry.name


@pytest.mark.long
@pytest.mark.parametrize("name", ["solo12", "go2", "talos"])
def test_hull_is_larger_than_the_mesh_by_little(name):
    """Supports of the shape and of the mesh's points in many directions."""
    robot = robots.load(name)
    found = {shape.name: shape for shape in robot_shapes(robot).shapes}
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for entry in robot.visual.geometry(robot.model, pin.GeometryType.COLLISION).geometryObjects:
        link = robot.model.frames[entry.parentFrame].name
        if link not in found or not isinstance(entry.geometry, coal.BVHModelBase):
            continue
        shape = found[link]
        frame = robot.model.frames[robot.model.getFrameId(shape.frame)].placement.inverse() * entry.placement
        points = np.array(entry.geometry.vertices()) @ frame.rotation.T + frame.translation
        own = (directions @ shape.points.T).max(axis=1) + shape.radius
        excess = own - (directions @ points.T).max(axis=1)
        assert excess.min() > -ROUNDING
        assert excess.max() < EXCESS


@pytest.mark.long
@pytest.mark.parametrize("name", robots.names())
def test_every_robot_has_shapes_and_no_judged_pair_overlaps_in_its_reference(name):
    robot = robots.load(name)
    found = robot_shapes(robot)
    if name in WITHOUT_GEOMETRY:
        assert found.shapes == ()
        return
    assert not found.missing
    names = [shape.name for shape in found.shapes]
    assert len(set(names)) == len(names)
    judged = {frozenset(pair) for pair in found.pairs}
    out = {frozenset(pair) for pair in found.left_out}
    assert not judged & out
    assert len(judged) + len(out) == len(names) * (len(names) - 1) // 2
    assert all(found.left_out.values())
    scene = found.scene(robot.model)
    if scene.pairs:
        assert scene.distances(robot.reference).min() >= 0
    moved = {robot.model.frames[robot.model.getFrameId(shape.frame)].parentJoint for shape in found.shapes}
    feet = {robot.model.frames[robot.model.getFrameId(c.frame)].parentJoint for c in robot.contacts}
    assert feet <= moved
    assert found.above_ground == (name not in ("acrobot", "double_pendulum", "pendubot"))


def test_shapes_are_the_same_each_time_and_read_once():
    first, second = (robot_shapes(robots.load("go2")) for _ in range(2))
    assert first is second
    inspect.unwrap(robot_shapes).__globals__["_robot_shapes"].cache_clear()
    assert robot_shapes(robots.load("go2")).describe() == first.describe()


def lowest(robot: Robot, q: np.ndarray) -> dict[str, float]:
    """Distance of every moving shape from level ground."""
    found = robot_shapes(robot)
    scene = CollisionScene(model=robot.model, shapes=found.shapes, terrain=FlatGround())
    return dict(zip((first for first, _ in scene.pairs), scene.distances(q)[0], strict=True))


@pytest.mark.parametrize("change", ["virtual", "planar", "locked"])
def test_shapes_stay_where_they_are_on_other_bases_and_with_locked_joints(change):
    robot = robots.load("solo12")
    urdf = robot.visual
    if change == "virtual":
        other = robot.with_virtual_base()
    elif change == "locked":
        other = robot.with_locked(["FL_KFE", "HR_HFE", "HR_KFE"])
    else:
        joints = robot.reference[7:]
        other = Robot.from_urdf(
            urdf.urdf,
            base="planar",
            contacts=robot.contacts,
            reference=joints,
            package_dirs=urdf.package_dirs,
        )
    expected, found = lowest(robot, robot.reference), lowest(other, other.reference)
    assert found == pytest.approx(expected, abs=1e-3)  # behind the last joints hulls are finer
    assert {s.name for s in robot_shapes(other).shapes} == {s.name for s in robot_shapes(robot).shapes}
    if change == "locked":
        left = robot_shapes(other).left_out
        assert left["FL_UPPER_LEG", "FL_FOOT"] == "on one link"
        assert left["HR_SHOULDER", "HR_FOOT"] == "on one link"


def test_sampled_postures_are_within_the_limits_and_keep_the_base():
    robot = robots.load("ur5")
    postures = sampled_postures(robot, 50)
    assert (postures >= np.maximum(robot.position_lower, robot.reference - np.pi) - 1e-9).all()
    assert (postures <= np.minimum(robot.position_upper, robot.reference + np.pi) + 1e-9).all()
    walker = robots.load("solo12")
    assert sampled_postures(walker, 5)[:, :7] == pytest.approx(np.tile(walker.reference[:7], (5, 1)))


def copied(tmp_path: Path) -> Path:
    """Puppy's description in a folder of its own."""
    shutil.copytree(PUPPY.parents[1], tmp_path / "puppy")
    return tmp_path / "puppy" / "urdf" / "puppy.urdf"


def read(urdf: Path) -> Robot:
    return Robot.from_urdf(urdf, contacts=["lf_foot"], package_dirs=[urdf.parents[2]])


def test_missing_and_damaged_meshes_are_named_and_the_others_are_there(tmp_path):
    urdf = copied(tmp_path)
    text = urdf.read_text(encoding="utf-8")
    whole = robot_shapes(read(urdf))
    broken = tmp_path / "broken.stl"
    broken.write_text("no mesh", encoding="utf-8")
    meshes = f'<collision><geometry><mesh filename="{broken}"/></geometry></collision>'
    meshes += '<collision><geometry><mesh filename="package://nowhere/part.stl"/></geometry></collision>'
    name = next(shape.name for shape in whole.shapes)
    link = name if f'name="{name}"' in text else name.rpartition("_")[0]
    urdf.write_text(text.replace(f'<link name="{link}">', f'<link name="{link}">{meshes}'), encoding="utf-8")
    found = robot_shapes(read(urdf))
    assert len(found.missing) == 2
    assert any("broken.stl" in line for line in found.missing)
    assert any("package://nowhere/part.stl" in line for line in found.missing)
    assert len(found.shapes) == len(whole.shapes)
    assert "cannot be read" in robot_report(read(urdf)).table()


def test_without_collision_elements_the_visual_ones_are_taken(tmp_path):
    urdf = copied(tmp_path)
    with_both = robot_shapes(read(urdf))
    text = urdf.read_text(encoding="utf-8").replace("collision>", "nothing>")
    urdf.write_text(text, encoding="utf-8")
    found = robot_shapes(read(urdf))
    assert found.shapes
    # Some links of it are only drawn.
    assert {shape.frame for shape in found.shapes} > {shape.frame for shape in with_both.shapes}


@pytest.mark.parametrize(("reason", "judged"), [("Never", True), ("Adjacent", False), ("", False)])
def test_srdf_leaves_out_pairs_that_touch_but_not_those_it_never_saw_touch(tmp_path, reason, judged):
    urdf = copied(tmp_path)
    first, second = robot_shapes(read(urdf)).pairs[-1]
    folder = urdf.parents[1] / "srdf"
    folder.mkdir()
    line = f'<disable_collisions link1="{second}" link2="{first}" reason="{reason}"/>'
    (folder / "puppy.srdf").write_text(f'<robot name="puppy">{line}</robot>', encoding="utf-8")
    urdf.write_text(urdf.read_text(encoding="utf-8") + "\n", encoding="utf-8")  # a new version of it
    found = robot_shapes(read(urdf))
    assert ((first, second) in found.pairs) is judged
    if not judged:
        assert found.left_out[first, second] == (f"SRDF: {reason}" if reason else "SRDF")


MJCF = """<mujoco model="two"><worldbody><body name="trunk"><freejoint name="root"/>
<geom type="box" size="0.2 0.1 0.05" mass="3"/><body name="leg" pos="0 0 -0.1">
<joint name="hip" axis="0 1 0" range="-1 1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1"/>
<geom type="sphere" pos="0 0 -0.33" size="0.04" mass="0.2"/></body></body></worldbody></mujoco>"""


def test_geoms_of_mjcf_are_shapes(tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(MJCF, encoding="utf-8")
    found = robot_shapes(Robot.from_mjcf(path))
    kinds = {shape.name: (shape.kind, shape.frame) for shape in found.shapes}
    assert kinds == {"trunk": ("box", "root"), "leg_0": ("capsule", "hip"), "leg_1": ("sphere", "hip")}


def test_report_counts_shapes_and_pairs_left_out_by_reason():
    found = robot_report(robots.load("solo12"))
    assert found.shapes.kinds == {"hull": 17}
    assert found.shapes.pairs == len(robot_shapes(robots.load("solo12")).pairs)
    assert len(found.shapes.left_out["neighbours"]) == 16
    assert "16 pairs not judged, neighbours: base_link and FL_SHOULDER" in found.table()
    assert found.to_dict()["shapes"]["kinds"] == {"hull": 17}
    assert "its links is not known" in robot_report(robots.load("irb1600")).table()


def test_boxes_of_inertias_are_the_boxes_with_these_inertias():
    model = pin.Model()
    sides, place = np.array([0.3, 0.1, 0.2]), pin.SE3(pin.exp3(np.ones(3)), np.array([0.1, 0.2, 0.3]))
    for name in ("one", "massless"):
        joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Random(), name)
        model.addJointFrame(joint)
    model.appendBodyToJoint(1, pin.Inertia.FromBox(2.0, *sides), place)
    (box,) = inertia_boxes(model)
    assert (box.kind, box.frame) == ("box", "one")
    corners = np.array([place.actInv(corner) for corner in box.points])
    assert np.abs(corners) == pytest.approx(np.tile(sides / 2, (8, 1)))
    assert len(np.unique(np.sign(corners), axis=0)) == 8


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
