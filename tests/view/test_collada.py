"""COLLADA meshes: the same shape as Pinocchio has, all colours of the file, clear refusals."""

import coal
import numpy as np
import pytest
from scipy.spatial import cKDTree

from trajopt.robot.data import robot_file
from trajopt.view.replay.collada import ColladaError, read_collada

UR5 = sorted(robot_file("ur_description/meshes/ur5/visual").glob("*.dae"))
SINGLE_PRECISION = 1e-6  # of lengths below a metre

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
    assert cKDTree(ours).query(theirs)[0].max() < SINGLE_PRECISION
    assert cKDTree(theirs).query(ours)[0].max() < SINGLE_PRECISION


def test_parts_of_one_geometry_keep_their_own_colours():
    mesh = read_collada(next(path for path in UR5 if path.stem == "shoulder"))
    stated = [[0.064, 0.064, 0.064], [0.1784, 0.1784, 0.1784], [0.3136, 0.4344, 0.512]]
    np.testing.assert_allclose(np.unique(mesh.colours, axis=0), stated, atol=SINGLE_PRECISION)


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
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [1, 2, 3], atol=SINGLE_PRECISION)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [3, 2, 5], atol=SINGLE_PRECISION)
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
