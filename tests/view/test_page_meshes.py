"""Meshes of a page: few bytes, COLLADA with all colours, and skeletons of robots without meshes."""

import shutil
import struct
from dataclasses import replace
from pathlib import Path

import coal
import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin
import pytest
import umsgpack
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull, cKDTree

from tests.support.page_meshes import array_of, restored
from tests.support.replay_pages import hopping, objects_of, placements_of, shown
from tests.support.synthetic_motions import arm_motion, at_rest, sampled, with_meta
from trajopt.robot.data import robot_file
from trajopt.view.replay.collada import ColladaError, read_collada
from trajopt.view.replay.meshes import LEVELS, compact_geometry
from trajopt.view.replay.robot import mesh_points, visuals_of
from trajopt_library import robots
from trajopt_library.robots.hopper import SLENDERNESS, TORSO_CENTRE, TORSO_LENGTH

HALF_STEP = 0.5 / LEVELS
SINGLE_PRECISION = 1e-7  # of the step and the corner that are added up
ONE_DEGREE = np.radians(1.0)
SEED = 3


@pytest.fixture(scope="module")
def ball() -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) and the triangles (m, 3) of their convex hull, wound outward."""
    rng = np.random.default_rng(SEED)
    points = rng.normal(size=(400, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    triangles = ConvexHull(points).simplices
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return points, triangles


def stl(corners: np.ndarray) -> dict:
    """Meshcat's geometry of a binary STL file with these corners (m, 3, 3)."""
    parts = [struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in corners]
    content = bytes(80) + struct.pack("<I", len(corners)) + b"".join(parts)
    return shapes.MeshGeometry(umsgpack.Ext(0x12, content), "stl").lower({})


def coloured(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, colours: np.ndarray) -> dict:
    attributes = {
        "position": shapes.pack_numpy_array(points.astype(np.float32).T),
        "normal": shapes.pack_numpy_array(normals.astype(np.float32).T),
        "color": {**shapes.pack_numpy_array(colours.astype(np.uint8).T), "normalized": True},
    }
    index = shapes.pack_numpy_array(triangles.astype(np.uint32).T)
    return {"type": "BufferGeometry", "data": {"attributes": attributes, "index": index}}


def index_of(mesh: dict) -> np.ndarray:
    return np.frombuffer(mesh["index"]["array"].data, np.uint32)


def test_triangles_of_a_file_come_back_in_order_within_half_a_step_along_each_axis(ball):
    points, triangles = ball
    points = points * [1.0, 0.2, 3.0] + [0.0, 5.0, -1.0]
    mesh = restored(compact_geometry(stl(points[triangles].astype(np.float32))))
    corners = array_of(mesh, "position")[index_of(mesh)].reshape(-1, 3, 3)
    error = np.abs(corners - points[triangles]).max(axis=(0, 1))
    allowed = HALF_STEP * np.ptp(points, axis=0) + SINGLE_PRECISION * np.abs(points).max(axis=0)
    assert (error <= allowed * 1.01).all()
    assert len(array_of(mesh, "position")) == len(points)


def test_normals_come_back_within_a_degree_and_colours_exactly(ball):
    points, triangles = ball
    rng = np.random.default_rng(SEED)
    palette = rng.integers(0, 256, size=(5, 3))
    colours = palette[rng.integers(0, 5, size=len(points))]
    mesh = restored(compact_geometry(coloured(points, triangles, points, colours)))
    order = np.argsort(index_of(mesh), kind="stable")  # any corner of each vertex tells which one it was
    vertex = np.empty(len(points), dtype=int)
    vertex[index_of(mesh)[order]] = triangles.ravel()[order]
    cosine = np.einsum("ij,ij->i", array_of(mesh, "normal"), points[vertex])
    assert np.arccos(np.clip(cosine, -1, 1)).max() < ONE_DEGREE
    np.testing.assert_array_equal(array_of(mesh, "color"), colours[vertex])


def test_file_that_draws_every_face_flat_loses_its_normals_and_keeps_its_shape(ball):
    points, triangles = ball
    corners = points[triangles].reshape(-1, 3)
    sides = points[triangles]
    flat = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    index = np.arange(len(corners)).reshape(-1, 3)
    grey = np.full((len(corners), 3), 128)
    packed = compact_geometry(coloured(corners, index, np.repeat(flat, 3, axis=0), grey))
    assert "normal" not in packed
    assert packed["vertices"] == len(points)


def test_triangle_that_shrinks_to_a_line_is_left_out(ball):
    points, triangles = ball
    corners = points[triangles]
    thin = np.array([[[0.1, 0, 0], [0.1 + 1e-7, 0, 0], [0.5, 0, 0]]])
    mesh = restored(compact_geometry(stl(np.concatenate([corners, thin]).astype(np.float32))))
    assert len(index_of(mesh)) == triangles.size


def test_flat_mesh_has_no_step_across_itself(ball):
    points, triangles = ball
    flat = points * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.25]
    mesh = restored(compact_geometry(stl(flat[triangles].astype(np.float32))))
    np.testing.assert_array_equal(array_of(mesh, "position")[:, 2], np.float32(0.25))


@pytest.mark.parametrize(
    "geometry",
    [
        {"type": "BoxGeometry", "width": 1.0},
        {"type": "_meshfile_geometry", "format": "obj", "data": "v 0 0 0\n" * 500},
        {"type": "_meshfile_geometry", "format": "stl", "data": b"solid text\n" * 500},
        {"type": "_meshfile_geometry", "format": "stl", "data": bytes(40)},
        stl(np.zeros((4, 3, 3))),
        stl(np.full((200, 3, 3), np.nan)),
    ],
)
def test_what_is_small_text_damaged_or_no_mesh_is_left_to_the_viewer(geometry):
    assert compact_geometry(geometry) is None


UR5 = sorted(robot_file("ur_description/meshes/ur5/visual").glob("*.dae"))
COLLADA_SINGLE_PRECISION = 1e-6  # of lengths below a metre

SQUARE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<library_effects><effect id="red"><profile_COMMON><technique sid="common"><lambert>
<diffuse><color>1 0 0 1</color></diffuse></lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="paint"><instance_effect url="#red"/></material></library_materials>
<library_geometries><geometry id="square"><mesh>
<source id="corners"><float_array id="numbers" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array>
<technique_common><accessor source="#numbers" count="4" stride="3"/></technique_common></source>
<vertices id="vertices"><input semantic="POSITION" source="#corners"/></vertices>
<polylist material="symbol" count="1"><input semantic="VERTEX" source="#vertices" offset="0"/>
<vcount>4</vcount><p>0 1 2 3</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="all"><node>{steps}<instance_geometry url="#square"><bind_material>
<technique_common>{bound}</technique_common></bind_material></instance_geometry></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#all"/></scene></COLLADA>"""
BOUND = '<instance_material symbol="symbol" target="#paint"/>'


def square(tmp_path, steps="", bound=BOUND):
    path = tmp_path / "square.dae"
    path.write_text(SQUARE.format(steps=steps, bound=bound))
    return path


def area(vertices, triangles):
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.linalg.norm(normals, axis=1).sum()


@pytest.mark.parametrize("path", UR5, ids=lambda path: path.stem)
def test_vertices_are_those_that_pinocchio_loads(path):
    # not its triangles: coal 3.0.3 mixes up the indices of a geometry with several materials
    ours = read_collada(path).vertices
    theirs = np.asarray(coal.MeshLoader().load(str(path), np.ones(3)).vertices())
    assert cKDTree(ours).query(theirs)[0].max() < COLLADA_SINGLE_PRECISION
    assert cKDTree(theirs).query(ours)[0].max() < COLLADA_SINGLE_PRECISION


def test_parts_of_one_geometry_keep_their_own_colours():
    mesh = read_collada(next(path for path in UR5 if path.stem == "shoulder"))
    stated = [[0.064, 0.064, 0.064], [0.1784, 0.1784, 0.1784], [0.3136, 0.4344, 0.512]]
    np.testing.assert_allclose(np.unique(mesh.colours, axis=0), stated, atol=COLLADA_SINGLE_PRECISION)


def test_normals_are_unit():
    mesh = read_collada(UR5[0])
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


def test_polygon_is_cut_into_triangles_and_coloured_by_its_material(tmp_path):
    mesh = read_collada(square(tmp_path))
    assert len(mesh.triangles) == 2
    assert area(mesh.vertices, mesh.triangles) == pytest.approx(1.0)
    np.testing.assert_array_equal(np.unique(mesh.colours, axis=0), [[1, 0, 0]])
    np.testing.assert_array_equal(np.unique(mesh.normals, axis=0), [[0, 0, 1]])


def test_part_without_material_takes_the_given_colour(tmp_path):
    mesh = read_collada(square(tmp_path, bound=""), plain=np.array([0.0, 0.5, 1.0]))
    np.testing.assert_array_equal(np.unique(mesh.colours, axis=0), [[0, 0.5, 1]])


def test_transformations_of_a_node_apply_in_their_order(tmp_path):
    steps = "<translate>1 2 3</translate><rotate>1 0 0 90</rotate><scale>2 2 -2</scale>"
    mesh = read_collada(square(tmp_path, steps))
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [1, 2, 3], atol=COLLADA_SINGLE_PRECISION)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [3, 2, 5], atol=COLLADA_SINGLE_PRECISION)
    corners = mesh.vertices[mesh.triangles[0]].astype(float)
    winding = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assert winding @ mesh.normals[mesh.triangles[0, 0]] > 0


@pytest.mark.parametrize(
    "damage", [lambda text: text[:400], lambda text: text.replace("0 1 2 3", "0 1 2 9"), lambda text: "<a/>"]
)
def test_damaged_file_is_refused_with_its_name(tmp_path, damage):
    path = square(tmp_path)
    path.write_text(damage(path.read_text()))
    with pytest.raises(ColladaError, match=r"square\.dae"):
        read_collada(path)


INTERVALS, DURATION = 3, 0.2  # s
SKELETON_SINGLE_PRECISION = 2e-6  # of lengths around one


def test_trunk_of_a_skeleton_is_the_box_of_its_inertia(tmp_path):
    robot = robots.load("hopper")
    data, force = robot.model.createData(), np.array([[0.0, 0, 98.1, 0, 0, 0]])
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    stance = replace(at_rest(robot, DURATION), contacts=("foot",), f=lambda t: force)
    scene = shown(sampled(robot, [stance], INTERVALS), tmp_path)
    path = next(path for path in objects_of(scene) if path.endswith("/trunk"))
    box, place = objects_of(scene)[path]["geometries"][0], placements_of(scene)[path]
    sides = np.array([box["width"], box["height"], box["depth"]])
    expected = np.array([SLENDERNESS, SLENDERNESS, 1.0]) * TORSO_LENGTH
    assert_allclose(np.sort(sides), expected, rtol=SKELETON_SINGLE_PRECISION)
    world = data.oMi[1].homogeneous @ place
    upright = np.array([0.0, 0.0, 1.0])
    assert_allclose(np.abs(world[:3, np.argmax(sides)]), upright, atol=SKELETON_SINGLE_PRECISION)
    hip = data.oMi[1].translation
    assert_allclose(world[:3, 3], hip + TORSO_CENTRE * TORSO_LENGTH * upright, atol=SKELETON_SINGLE_PRECISION)


def test_skeleton_on_a_fixed_base_has_no_trunk(tmp_path):
    robot = robots.load("ur5")
    scene = shown(sampled(robot, [arm_motion(robot)], INTERVALS), tmp_path)
    assert not any(path.endswith("/trunk") for path in objects_of(scene))
    assert any("/rod" in path for path in objects_of(scene))


def test_base_without_mass_or_extent_has_no_trunk(tmp_path):
    bones = with_meta(hopping(), visual=None)
    model = bones.model.copy()
    for inertia in (pin.Inertia.Zero(), pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))):
        model.inertias[1] = inertia
        scene = shown(replace(bones, model=model), tmp_path)
        assert not any(path.endswith("/trunk") for path in objects_of(scene))


# Meshes that are found, and those that are not


@pytest.mark.long
@pytest.mark.parametrize("name", ["solo12", "anymal_c", "ur5", "talos"])
def test_visuals_are_those_that_pinocchio_reads(name):
    robot = robots.load(name)
    found, whole = visuals_of(robot.visual, robot.model), robot.visual.geometry(robot.model)
    assert not found.missing
    assert [entry.name for entry in found.geometry.geometryObjects] == [e.name for e in whole.geometryObjects]
    for own, other in zip(found.geometry.geometryObjects, whole.geometryObjects, strict=True):
        assert own.parentJoint == other.parentJoint
        assert own.placement == other.placement
        assert_allclose(own.meshColor, other.meshColor)
        if own.name in found.meshes:
            assert Path(own.meshPath) == Path(other.meshPath)
            assert_allclose(own.meshScale, other.meshScale)


@pytest.mark.long
@pytest.mark.parametrize("name", ["solo12", "ur5"])
def test_points_of_meshes_span_what_pinocchio_loads(name):
    robot = robots.load(name)
    for entry in robot.visual.geometry(robot.model).geometryObjects:
        points, whole = mesh_points(entry.meshPath, entry.meshScale), entry.geometry.vertices()
        for extreme in (np.min, np.max):
            assert_allclose(extreme(points, axis=0), extreme(whole, axis=0), atol=SKELETON_SINGLE_PRECISION)


def partly_there(tmp_path: Path, *, damaged: bool) -> Path:
    """A copy of Solo12's description in which one mesh file is missing, or holds no mesh."""
    source = robot_file("solo_description")
    copied = tmp_path / "share" / "example-robot-data" / "robots" / "solo_description"
    shutil.copytree(source, copied)
    lost = sorted((copied / "meshes").rglob("solo12/solo12_hip_fe_fl.stl"))[0]
    lost.unlink()
    if damaged:
        lost.write_text("no mesh")
    return tmp_path / "share"


@pytest.mark.parametrize("damaged", [False, True])
def test_robot_is_drawn_without_the_mesh_that_is_missing_and_one_line_names_it(tmp_path, capsys, damaged):
    share = partly_there(tmp_path, damaged=damaged)
    urdf = share / "example-robot-data/robots/solo_description/robots/solo12.urdf"
    told = with_meta(hopping(), visual={"urdf": str(urdf), "package_dirs": [str(share)]})
    page = shown(told, tmp_path)
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert ("FL_SHOULDER" if damaged else "solo12_hip_fe_fl.stl") in said
    assert "skeleton" not in said
    drawn = [path for path in objects_of(page) if path.startswith("robot/")]
    assert len(drawn) == 17 - 1
    assert not any("FL_SHOULDER" in path for path in drawn)
