"""Meshes in few bytes are the meshes they were made of, within the stated error."""

import struct

import meshcat.geometry as shapes
import numpy as np
import pytest
import umsgpack
from scipy.spatial import ConvexHull

from tests.support.page_meshes import array_of, restored
from trajopt.view.replay.meshes import LEVELS, compact_geometry

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
