"""Clearance of the robot's links from obstacles, the ground and each other."""

from dataclasses import dataclass

from trajopt.arguments import NonNegative, checked
from trajopt.collision.shapes import LinkShape, Obstacle, require_different_names
from trajopt.terms.interfaces import Term


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Clearance(Term):
    """The robot's links stay clear of obstacles, of the ground and of each other, at all times.

        d_ij(q(t)) >= margin                             link i and obstacle j
        d_ij(q(t)) >= min(margin, d_ij(q_reference))     links i and j
        d_ij(q(t)) >= 0                                  link i and the ground

    with d the signed distance in m. A problem without this term uses it with its defaults. The term has no
    rows itself: a solve inspects the whole motion and adds rows for pairs that come too near, at the moments
    where they do (`trajopt.solving.exchange`).

    Args:
        obstacles: obstacles, placed in the world.
        margin: least distance from obstacles and between links, m.
        shapes: shapes of the robot's links; default those of its description (`robot_shapes`).
        self_collision: whether links are kept apart from each other.

    Raises:
        InputError: for a negative margin, and two obstacles of the same name.
    """

    obstacles: tuple[Obstacle, ...] = ()
    margin: NonNegative = 0.0
    shapes: tuple[LinkShape, ...] | None = None
    self_collision: bool = True

    def __post_init__(self) -> None:
        require_different_names("obstacles", [obstacle.name for obstacle in self.obstacles])
