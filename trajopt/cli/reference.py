"""``trajopt reference``: a converged solution that others are compared with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import THREADS, values_of
from trajopt.cli.report import to_json
from trajopt.solution.output import check_output

if TYPE_CHECKING:
    from trajopt.solving.reference import MeshSolve

NOT_REACHED = 1


@click.command()
@click.argument("problem")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter, e.g. yaw=45deg.")
@click.option(
    "--transcription", "scheme", default="legendre:3", metavar="NAME", show_default=True, help="Scheme."
)
@click.option("--solver", default="ipopt", metavar="NAME", show_default=True, help="As of `solve`.")
@click.option(
    "--tol", "tolerance", type=float, default=1e-9, metavar="TOL", show_default=True, help="Tolerance."
)
@click.option(
    "--objective", type=float, default=1e-5, metavar="PART", show_default=True, help="Agreement, relative."
)
@click.option(
    "--distance", type=float, default=1e-3, metavar="PART", show_default=True, help="Agreement, of the reach."
)
@click.option(
    "--max-time", type=float, default=600.0, metavar="S", show_default=True, help="Time limit in s."
)
@click.option("--compile", default="quick", metavar="LEVEL", show_default=True, help="none, quick or fast.")
@click.option("--threads", type=THREADS, default=1, metavar="N", show_default=True, help="For functions.")
@click.option(
    "-o", "--output", type=Path, metavar="FILE", help="Solution file.  [default: PROBLEM-reference.npz]"
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def reference(
    problem: str,
    settings: tuple[str, ...],
    objective: float,
    distance: float,
    output: Path | None,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Solve PROBLEM on finer and finer meshes until two agree, and write the finest.

    Exit status 1 when no two do within the time: what is in the way is printed, and no file written.
    """
    from trajopt.problem.catalogue import families
    from trajopt.problem.family import choose
    from trajopt.solving.reference import Agreement, NoReferenceError, converged_reference

    loaded = choose(families(), problem).load(values_of(settings, "--set"))
    target = check_output(output or Path(f"{problem}-reference.npz"))
    bounds = Agreement(objective=objective, distance=distance)
    try:
        found = converged_reference(loaded, agreement=bounds, progress=_show, **arguments)
    except NoReferenceError as error:
        click.echo(f"trajopt: {error}", err=True)
        return NOT_REACHED
    found.solution.save(target)
    shown = {**found.to_dict(), "file": str(target)}
    click.echo(to_json(shown) if as_json else f"{found}\n{target}")
    return 0


def _show(rung: MeshSolve) -> None:
    click.echo(str(rung), err=True)
