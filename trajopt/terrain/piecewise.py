"""Ground made of plane faces, each bounded by a convex polygon: stairs, boxes, gaps, stones, slopes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.errors import InputError, shown
from trajopt.terrain.patch import ObstacleAxes, Patch, PlanePoint
from trajopt.terrain.surface import MOST_SHAPES, UP, Surface

# Extent of the flats before and beyond an obstacle, m: farther than the motion of any plan.
REACH = 20.0
# Positions this far outside a polygon still stand on it, m: two faces that share an edge leave no crack.
CRACK = 1e-9


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewiseTerrain:
    """Ground of one or more faces with different names; contacts stand on the first by default.

    The ground at (x, y) is the highest face there. Where there is no face there is a bottomless hole: its
    height is -inf, nothing penetrates it, and no contact can stand in it. Risers between faces are not faces:
    a point lower than the highest face at its (x, y) penetrates by the whole difference. The constructors
    below place an obstacle ``at`` (x, y) m, turned by ``yaw`` rad; all its faces have the same ``friction``
    and ``margin``, m, see `Patch`.

    Args:
        faces: the faces, at least one.

    Raises:
        InputError: for two faces of the same name, and a face that is vertical, points down or is bilateral.
    """

    faces: tuple[Patch, ...]
    raised: float = field(default=0.0, init=False, repr=False)
    """Distance in m of these faces from the ground, where they are parallel to it (see `offset`)."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.faces) <= MOST_SHAPES:
            raise InputError(
                f"a piecewise terrain has {len(self.faces)} faces",
                f"allowed: patches, at least one, at most {MOST_SHAPES}",
            )
        names = self.names
        if len(set(names)) != len(names):
            raise InputError(f"two faces of a terrain have the same name: {', '.join(names)}")
        for face in self.faces:
            if not face.surface.normal[2] > 0 or face.surface.bilateral:
                raise InputError(
                    f"face '{face.name}' of the terrain points down, is vertical or holds contacts",
                    "allowed: ground to stand on, normal with z > 0; Phase.patches and surfaces for others",
                )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the faces."""
        return tuple(face.name for face in self.faces)

    def face(self, name: str) -> Patch:
        """The face of that name. Raises `InputError`."""
        for face in self.faces:
            if face.name == name:
                return face
        raise InputError(f"the terrain has no face '{name}'", f"allowed: {', '.join(self.names)}")

    @property
    def friction(self) -> float:
        """Friction coefficient of the first face."""
        return self.faces[0].surface.friction

    @property
    def surface(self) -> Surface:
        """Plane of the first face."""
        return self.faces[0].surface

    def height(self, x: Any, y: Any) -> np.ndarray:
        """Height (...) in m of the ground at x, y (...) m; -inf in a hole."""
        return np.asarray(self._heights(x, y).max(axis=0))

    def normal(self, x: Any, y: Any) -> np.ndarray:
        """Unit normal (..., 3) of the highest face at x, y (...) m; up in a hole."""
        heights = self._heights(x, y)
        normals = np.array([face.surface.normal for face in self.faces])[heights.argmax(axis=0)]
        return np.where(np.isfinite(heights.max(axis=0))[..., None], normals, np.array(UP))

    def face_at(self, x: float, y: float) -> Patch | None:
        """The highest face at (x, y) m; None in a hole."""
        heights = self._heights(x, y)
        return self.faces[int(heights.argmax())] if np.isfinite(heights.max()) else None

    def surface_at(self, point: np.ndarray) -> Surface:
        """The surface under a position (3,) m. Raises `InputError` in a hole."""
        face = self.face_at(float(point[0]), float(point[1]))
        if face is None:
            raise InputError(
                f"a contact stands at {np.round(point, 6).tolist()} m, where the terrain has no face",
                f"allowed: on one of its faces {', '.join(self.names)}",
            )
        return face.surface

    def offset(self, distance: float) -> PiecewiseTerrain:
        """The parallel ground: every face shifted ``distance`` m along its normal.

        Where two faces meet in a convex edge the shifted ones separate. There the ground is the plane of the
        steeper one, above the arc of the exact parallel surface by less than distance * (1 / n_z - 1).
        """
        if not distance:
            return self
        if distance not in self._parallel:
            shifted = PiecewiseTerrain(faces=tuple(face.offset(distance) for face in self.faces))
            object.__setattr__(shifted, "raised", self.raised + distance)
            self._parallel[distance] = shifted
        return self._parallel[distance]

    @cached_property
    def _parallel(self) -> dict[float, PiecewiseTerrain]:
        """Cache of parallel grounds by their distance in m."""
        return {}

    def _heights(self, x: Any, y: Any) -> np.ndarray:
        """Heights (faces, ...) in m of all faces at x, y (...), -inf outside of them."""
        across, along = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        heights = []
        for face in self.faces:
            normal, height = face.surface.normal, face.surface.height
            upward = float(normal[2])
            # A position this far outside the polygon, m, still stands on the face.
            crack = CRACK + self.raised * math.sqrt(max(1.0 - upward * upward, 0.0)) / upward
            z = (height - normal[0] * across - normal[1] * along) / normal[2]
            inside = face.inside(np.stack([across, along, z], axis=-1)) >= -crack
            heights.append(np.where(inside, z, -np.inf))
        return np.array(heights)

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return {"kind": "piecewise", "faces": [face.describe() for face in self.faces]}

    @classmethod
    def from_description(cls, described: Any) -> PiecewiseTerrain:
        """The terrain that ``describe`` wrote. Raises `InputError`."""
        faces = described.get("faces") if isinstance(described, dict) else None
        if not isinstance(faces, list):
            raise InputError(
                "a piecewise terrain is described without a list of faces", "allowed: kind, faces"
            )
        return cls(faces=tuple(Patch.from_description(face) for face in faces))

    @classmethod
    @checked
    def steps(
        cls,
        heights: Sequence[float],
        run: Positive,
        *,
        width: Positive = 2 * REACH,
        at: PlanePoint = (0.0, 0.0),
        yaw: float = 0.0,
        friction: float = 0.7,
        margin: float = 0.0,
    ) -> PiecewiseTerrain:
        """Level treads: faces ``before``, ``step1``, ..., ``beyond``.

        Args:
            heights: heights of the treads over the ground before them, m; the last is the flat ``beyond``.
            run: depth of a tread, m.
            width: width across the steps, m.
            at: position of the first riser (x, y), m.
            yaw: direction of the steps, rad.
            friction: Coulomb's coefficient.
            margin: margin of each face, see `Patch`, m.
        """
        levels = np.array(heights, dtype=float).ravel()
        if not len(levels) or not np.isfinite(levels).all():
            raise InputError(
                f"heights of steps are {shown(heights)} m", "allowed: one or more finite numbers"
            )
        place = ObstacleAxes(at, yaw, friction, margin)
        edges = [-REACH, *(run * np.arange(len(levels))), run * (len(levels) - 1) + REACH]
        names = ["before", *(f"step{i}" for i in range(1, len(levels))), "beyond"]
        strips = zip(names, edges[:-1], edges[1:], [0.0, *levels], strict=True)
        side = (-width / 2, width / 2)
        return cls(faces=tuple(place.rectangle(name, (a, b), side, (z, z)) for name, a, b, z in strips))

    @classmethod
    @checked
    def stairs(
        cls,
        rise: float,
        run: Positive,
        steps: PositiveCount,
        width: Positive = 2 * REACH,
        *,
        at: PlanePoint = (0.0, 0.0),
        yaw: float = 0.0,
        friction: float = 0.7,
        margin: float = 0.0,
    ) -> PiecewiseTerrain:
        """Stairs: ``steps`` risers of ``rise`` m (negative: down) and treads of ``run`` m, see `steps`."""
        heights = [rise * (i + 1) for i in range(steps)]
        return cls.steps(heights, run, width=width, at=at, yaw=yaw, friction=friction, margin=margin)

    @classmethod
    @checked
    def box(
        cls,
        height: float,
        length: Positive,
        width: Positive,
        at: PlanePoint = (0.0, 0.0),
        *,
        yaw: float = 0.0,
        friction: float = 0.7,
        margin: float = 0.0,
    ) -> PiecewiseTerrain:
        """A ``box`` on level ground.

        The faces around it are ``before`` (smaller x), ``beyond``, ``left`` (greater y) and ``right``, which
        overlap at the corners.

        Args:
            height: height of the box, m; negative for a pit.
            length: length along x, m.
            width: width along y, m.
            at: centre of the box (x, y), m.
            yaw: angle of its axes, rad.
            friction: Coulomb's coefficient.
            margin: margin of each face, see `Patch`, m.
        """
        place, a, b = ObstacleAxes(at, yaw, friction, margin), length / 2, width / 2
        far, ground = (-REACH, REACH), (0.0, 0.0)
        faces = (
            place.rectangle("before", (-REACH, -a), far, ground),
            place.rectangle("box", (-a, a), (-b, b), (height, height)),
            place.rectangle("beyond", (a, REACH), far, ground),
            place.rectangle("left", far, (b, REACH), ground),
            place.rectangle("right", far, (-REACH, -b), ground),
        )
        return cls(faces=faces)

    @classmethod
    @checked
    def gap(
        cls,
        width: Positive,
        *,
        height: float = 0.0,
        at: PlanePoint = (0.0, 0.0),
        yaw: float = 0.0,
        friction: float = 0.7,
        margin: float = 0.0,
    ) -> PiecewiseTerrain:
        """A hole of ``width`` m from ``at`` (x, y) m on, between the faces ``before`` and ``beyond``.

        ``height`` is that of the ground beyond the hole above the ground before it, m.
        """
        place = ObstacleAxes(at, yaw, friction, margin)
        side = (-REACH, REACH)
        faces = (
            place.rectangle("before", (-REACH, 0.0), side, (0.0, 0.0)),
            place.rectangle("beyond", (width, width + REACH), side, (height, height)),
        )
        return cls(faces=faces)

    @classmethod
    @checked
    def slope(
        cls,
        rise: float,
        length: Positive,
        *,
        width: Positive = 2 * REACH,
        at: PlanePoint = (0.0, 0.0),
        yaw: float = 0.0,
        friction: float = 0.7,
        margin: float = 0.0,
    ) -> PiecewiseTerrain:
        """A ``slope`` that rises by ``rise`` m over ``length`` m, from ``at`` (x, y) m, between two flats."""
        place, side = ObstacleAxes(at, yaw, friction, margin), (-width / 2, width / 2)
        faces = (
            place.rectangle("before", (-REACH, 0.0), side, (0.0, 0.0)),
            place.rectangle("slope", (0.0, length), side, (0.0, rise)),
            place.rectangle("beyond", (length, length + REACH), side, (rise, rise)),
        )
        return cls(faces=faces)

    @classmethod
    @checked
    def stepping_stones(
        cls,
        centres: Sequence[PlanePoint] | np.ndarray,
        size: float | tuple[float, float],
        heights: float | Sequence[float] = 0.0,
        *,
        yaw: float = 0.0,
        friction: float = 0.7,
        margin: float = 0.0,
    ) -> PiecewiseTerrain:
        """Level stones ``stone1``, ... and holes between: ``centres`` (n, 2), ``size`` and ``heights``, m."""
        places = np.array(centres, dtype=float)
        if places.ndim != 2 or places.shape[1:] != (2,) or not len(places) or not np.isfinite(places).all():
            raise InputError(f"centres of stones have shape {places.shape}", "allowed: (n, 2), finite, m")
        levels = np.asarray(heights, dtype=float)
        if levels.shape not in ((), (len(places),)):
            raise InputError(
                f"{levels.size} heights for {len(places)} stones", "allowed: one, or one for each stone"
            )
        sides = (size, size) if isinstance(size, int | float) else size
        return cls(
            faces=tuple(
                Patch.rectangle(
                    (*place, z), sides, yaw=yaw, friction=friction, margin=margin, name=f"stone{i}"
                )
                for i, (place, z) in enumerate(
                    zip(places, np.broadcast_to(levels, len(places)), strict=True), start=1
                )
            )
        )
