"""A problem with another friction cone, and the kind of its own."""

from dataclasses import fields, replace

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.terms.friction import ContactConstraint, FrictionCone, FrictionPyramid
from trajopt.terms.interfaces import Term

KINDS: dict[str, type[ContactConstraint]] = {"smooth": FrictionCone, "pyramid": FrictionPyramid}


def cone_of(problem: Problem) -> str | None:
    """Kind of the friction terms for points: ``smooth``, ``pyramid``, ``own`` for both, None without any."""
    kinds = {
        kind for kind, term_type in KINDS.items() if any(type(term) is term_type for term in problem.terms)
    }
    if len(kinds) == 1:
        return kinds.pop()
    return "own" if kinds else None


def with_cone(problem: Problem, kind: str) -> Problem:
    """Convert all friction terms for point contacts to that kind; ``own`` leaves the problem unchanged.

    The pyramid is inscribed in the cone: where friction is active, the two problems have different optima.
    The cones of soles (`SoleCone`) are already pyramids and stay. Raises InputError if there is no friction
    term.
    """
    current = cone_of(problem)
    if kind in ("own", current):
        return problem
    if current is None:
        raise InputError(
            f"problem '{problem.name}' has no friction term of point contacts", "allowed: no --cone"
        )
    return replace(problem, terms=tuple(_as_kind(term, KINDS[kind]) for term in problem.terms))


def _as_kind(term: Term, kind: type[ContactConstraint]) -> Term:
    """Convert a friction term to another kind with the same values; other terms are returned unchanged."""
    if type(term) not in KINDS.values():
        return term
    return kind(**{entry.name: getattr(term, entry.name) for entry in fields(term) if entry.init})
