"""The collision shapes of a robot in figures: how many of which kind, and which pairs are not judged."""

from collections import Counter
from dataclasses import dataclass

from trajopt.collision.description import RobotShapes, robot_shapes
from trajopt.collision.shapes import KINDS
from trajopt.robot.robot import Robot

# Pairs and files that the text names for each reason; the JSON has all of them.
NAMED = 3


@dataclass(frozen=True, kw_only=True)
class ShapeFacts:
    """Shapes of a robot's links.

    kinds: number of each. pairs: number of those that must not touch. left_out: the other pairs by the reason
    for which they are not judged. missing: what could not be read. above_ground: whether the ground is solid
    to the robot.
    """

    kinds: dict[str, int]
    pairs: int
    left_out: dict[str, tuple[tuple[str, str], ...]]
    missing: tuple[str, ...]
    above_ground: bool

    def lines(self) -> list[str]:
        """The facts as text, one a line."""
        if not self.kinds:
            return ["none: the size of its links is not known", *self._missing()]
        counts = [f"{number} {_plural(kind, number)}" for kind, number in self.kinds.items()]
        lines = [f"{', '.join(counts)}; {self.pairs} {_plural('pair', self.pairs)} must not touch"]
        for reason, pairs in self.left_out.items():
            named = ", ".join(f"{first} and {second}" for first, second in pairs[:NAMED])
            more = ", ..." if len(pairs) > NAMED else ""
            lines.append(f"{len(pairs)} {_plural('pair', len(pairs))} not judged, {reason}: {named}{more}")
        if not self.above_ground:
            lines.append("links reach below the base's ground in the reference posture: it is not judged")
        return lines + self._missing()

    def _missing(self) -> list[str]:
        if not self.missing:
            return []
        more = ", ..." if len(self.missing) > NAMED else ""
        return [f"{len(self.missing)} shapes cannot be read: {'; '.join(self.missing[:NAMED])}{more}"]


def shape_facts(robot: Robot) -> ShapeFacts:
    """Return the figures of `robot_shapes`."""
    shapes = robot_shapes(robot)
    counts = Counter(shape.kind for shape in shapes.shapes)
    return ShapeFacts(
        kinds={kind: counts[kind] for kind in KINDS if counts[kind]},
        pairs=len(shapes.pairs),
        left_out=_by_reason(shapes),
        missing=shapes.missing,
        above_ground=shapes.above_ground,
    )


def _by_reason(shapes: RobotShapes) -> dict[str, tuple[tuple[str, str], ...]]:
    """Pairs by reason; the depths of overlaps are left out."""
    reasons: dict[str, list[tuple[str, str]]] = {}
    for pair, reason in shapes.left_out.items():
        what = "overlap in the reference posture" if "reference" in reason else reason
        reasons.setdefault(what, []).append(pair)
    return {reason: tuple(pairs) for reason, pairs in reasons.items()}


def _plural(word: str, number: int) -> str:
    ending = "es" if word.endswith("x") else "s"
    return word if number == 1 else word + ending
