"""What runs of `trajopt bench suite --output-dir` found, from their files."""

import json
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any

import click

from scripts.measure.shared import head, row

Pair = dict[str, Any]
LEGGED = ("solo12", "go2", "anymal_c", "a1", "hyq", "talos", "g1", "bolt", "talos_arms", "g1_arms")
folder = click.Path(exists=True, file_okay=False, path_type=Path)


@click.command()
@click.argument("graded", type=folder)
@click.argument("fixed", type=folder)
def suite(graded: Path, fixed: Path) -> None:
    """Pairs that hold and solver times of two runs: to the grade, and with --fixed-mesh."""
    runs = [pairs(run) for run in (graded, fixed)]
    seconds = [[each["own"]["wall_time"] for each in run] for run in runs]
    missed = [
        name_of(each) for each in runs[0] if not all(start["status"] == "solved" for start in each["starts"])
    ]
    head("", "to the grade", "`--fixed-mesh`")
    row("pairs", *(len(run) for run in runs))
    row("hold at any time, from the default guess", *(sum(each["ok"] for each in run) for run in runs))
    started = f"{len(runs[0]) - len(missed)} (not {', '.join(missed)})" if missed else len(runs[0])
    row("from every perturbed start", started, "")
    row("on the first mesh", sum(each["ok"] and each["own"]["meshes"] == 1 for each in runs[0]), "")
    row("solver time, median of all pairs", *(f"{median(run):.2f} s" for run in seconds))
    row("median of each pair's ratio", f"{median(a / b for a, b in zip(*seconds, strict=True)):.2f}", 1)
    for legged, name in ((False, "fixed base"), (True, "legged")):
        counts = [each["own"]["iterations"] for each in runs[0] if each["own"]["legged"] is legged]
        row(f"iterations, median, {name}", f"{median(counts):g}", "")


@click.command()
@click.argument("graded", type=folder)
def library(graded: Path) -> None:
    """Iterations of every pair on all its meshes."""
    head("problem", "iterations on all meshes (meshes), by robot")
    for problem, group in groupby(pairs(graded), key=lambda pair: pair["problem"]):
        own = ((each["robot"], each["own"]["iterations"], each["own"]["meshes"]) for each in group)
        row(f"`{problem}`", ", ".join(f"{robot} {count} ({meshes})" for robot, count, meshes in own))


@click.command()
@click.argument("simulated", type=folder)
def tracking(simulated: Path) -> None:
    """Errors of the base at the end, mm, of plans in a run with --simulate; off or fell: not tracked."""
    known = [each for each in pairs(simulated) if each["robot"] in LEGGED and each["physics"]]
    head("problem", *LEGGED)
    for problem, group in groupby(known, key=lambda pair: pair["problem"]):
        cells = {each["robot"]: _base_error(each["physics"]) for each in group}
        row(problem, *(cells.get(robot, "") for robot in LEGGED))
    words = [[each["physics"]["word"] for each in known if each["robot"] == robot] for robot in LEGGED]
    row("tracked", *(f"{own.count('tracked')} of {len(own)}" for own in words))


def _base_error(physics: Pair) -> str:
    if physics["word"] == "fell" or physics["base_error_end"] is None:
        return str(physics["word"])
    error = f"{1e3 * physics['base_error_end']:.1f}"
    return error if physics["word"] == "tracked" else f"{error} off"


def pairs(run: Path) -> list[Pair]:
    """Outcomes of a run, by problem and robot."""
    lines = (run / "results.jsonl").read_text(encoding="utf-8").splitlines()
    return sorted((json.loads(line)["outcome"] for line in lines), key=name_of)


def name_of(pair: Pair) -> str:
    """`PROBLEM@ROBOT`."""
    return f"{pair['problem']}@{pair['robot']}"
