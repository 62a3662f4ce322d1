"""The pairs of problem and robot, and their selection."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from trajopt.errors import InputError, expanded, not_among
from trajopt.problem.family import Family
from trajopt.robot.catalogue import is_packaged, kind_if_known, robot_kind

# Suffix of a file that builds a robot; it may name a robot that no family lists.
ROBOT_FILE = ".py"


@dataclass(frozen=True, kw_only=True, order=True)
class Pair:
    """One problem, followed by a colon and a setting if it has one, on one robot."""

    problem: str
    robot: str

    @property
    def name(self) -> str:
        """The pair as one word, ``problem@robot``."""
        return f"{self.problem}@{self.robot}"

    @property
    def family(self) -> str:
        """Name of the problem's family."""
        return self.problem.partition(":")[0]


@dataclass(frozen=True, kw_only=True, order=True)
class Case(Pair):
    """A pair to run with all other parameters of the problem at their defaults."""

    takes_robot: bool

    @property
    def values(self) -> dict[str, object]:
        """Parameters with which to load the family."""
        values: dict[str, object] = {"robot": self.robot} if self.takes_robot else {}
        _, _, setting = self.problem.partition(":")
        name, _, value = setting.partition("=")
        return values | ({name: value} if setting else {})


def all_cases(families: Mapping[str, Family]) -> tuple[Case, ...]:
    """Every family on every robot that it lists, and its variants on theirs, sorted."""
    return tuple(
        sorted(
            Case(problem=problem, robot=robot, takes_robot=family.takes_robot)
            for family in families.values()
            for problem, robots in family.tested
            for robot in robots
        )
    )


def select(
    families: Mapping[str, Family], problems: Sequence[str] = (), robots: Sequence[str] = ()
) -> tuple[Case, ...]:
    """The cases whose problem matches a pattern and whose robot is named; an empty sequence selects all.

    problems: as in `Pair`, or patterns with ``*``, ``?`` and ``[...]``. robots: names, or ``.py`` files that
    build one. A robot that no family lists is paired with the families that take one and list one of its
    kind. Raises InputError for a pattern or a robot that matches nothing, and if no pair is left.
    """
    cases = all_cases(families)
    names, known = {case.problem for case in cases}, {case.robot for case in cases}
    for pattern in problems:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise not_among(sorted(names), pattern, f"problem '{pattern}' is unknown")
    chosen = {case for case in cases if not robots or case.robot in robots}
    for robot in robots:
        if robot not in known:
            chosen |= _unnamed(robot, families, known)
    if problems:
        chosen = {case for case in chosen if any(fnmatchcase(case.problem, one) for one in problems)}
    if not chosen:
        raise InputError(
            f"no problem of {', '.join(problems) or 'all'} is run on {', '.join(robots)}",
            "allowed: the pairs of trajopt bench suite `list`",
        )
    return tuple(sorted(chosen))


def _unnamed(robot: str, families: Mapping[str, Family], known: Iterable[str]) -> set[Case]:
    """Pair a robot that no family lists with the families that take a robot and list one of its kind."""
    if robot.endswith(ROBOT_FILE) and not expanded(robot).is_file():
        raise InputError(f"there is no robot file {robot}", "allowed: a .py file with build()")
    if robot.endswith(ROBOT_FILE) or is_packaged(robot):
        kind = robot_kind(robot)
    elif (kind := kind_if_known(robot)) is None:
        raise not_among(sorted(known), robot, f"robot '{robot}' is unknown")
    return {
        Case(problem=problem, robot=robot, takes_robot=True)
        for family in families.values()
        for problem, _ in family.tested
        if family.takes_robot and (kind is None or kind_if_known(family.robot) in (None, kind))
    }
