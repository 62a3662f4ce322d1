"""Places of the library where a contact is with surroundings that do not move (docs/discovery.md)."""

import re
from pathlib import Path

import click

import trajopt
from scripts.measure.shared import head, row

# Of each place a pattern, the folders or files of `trajopt` that are searched, and what pairs need there.
PLACES = {
    "rows of contacts": (
        r"held_rows|context\.frame\(contact",
        "terms transcription/symbols.py transcription/robot_layers.py",
        "are of one frame's motion; a pair needs the difference of two, in the axes of the second",
    ),
    "axes of forces": (
        r"surface_force|surface\.frame|symbolic_frame",
        "terms",
        "are constants or follow from a place; those of a face turn with its body",
    ),
    "loads": (
        r"fused\(|loaded_frames|_loads\(",
        "transcription dynamics/rigid_body.py",
        "have one frame for each wrench; a pair loads a second one with the opposite wrench",
    ),
    "landing": (
        r"ContactLanding|along_ground|along_normal|contact_points",
        "terms transcription problem",
        "is a height over ground; on a face it is a place in the axes of a body",
    ),
    "redundant rows": (
        r"independent_rows|contact_jacobian",
        "transcription dynamics robot",
        "are found from Jacobians of single frames; loads of a sliding block depend on each other, too",
    ),
    "touched surfaces": (
        r"TouchedSurfaces|\btouched\b",
        "motion certify control simulation",
        "are planes with a point and a normal at each sample; a face has a velocity and an acceleration, too",
    ),
    "open-loop check": (
        r"ContactSet|contact_kinematics|ContactKinematics",
        "certify diagnosis",
        "solves for forces of contacts with the world, in Python and in the extension's integrator",
    ),
    "bodies that stay apart": (
        r"contacts_by_shape|is_foot|self_margins",
        "problem transcription certify motion solving",
        "know feet that may touch the ground; a finger may touch a face in some phases and not in others",
    ),
    "file and exports": (
        r"\.f\[|solution\.f\b",
        "solution export control view certify motion",
        "have one wrench for each contact, whose reaction acts on the world",
    ),
    "MuJoCo's world": (
        r"_pairs?\(|\bpairs\b",
        "simulation",
        "pairs feet with ground or obstacles; a block needs a geom, and feedback does not know of it",
    ),
}


@click.command("object-places")
def object_places() -> None:
    """Lines and files of the library that match what pairs of bodies would change."""
    root = Path(trajopt.__file__).parent
    head("place", "lines", "files", "what stands there, and what pairs need")
    for place, (pattern, folders, needed) in PLACES.items():
        files = [path for part in folders.split() for path in _sources(root / part)]
        counts = [
            sum(bool(re.search(pattern, line)) for line in path.read_text().splitlines()) for path in files
        ]
        row(place, sum(counts), sum(count > 0 for count in counts), needed)


def _sources(path: Path) -> list[Path]:
    return [path] if path.is_file() else [each for kind in ("*.py", "*.cpp") for each in path.rglob(kind)]
