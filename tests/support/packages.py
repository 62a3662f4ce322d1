"""Packages of problem families as pip installs them, for tests that bring their own families."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pytest


def install(module: ModuleType, folder: Path) -> None:
    """The metadata that make a module a package of problems, as pip writes them."""
    name = module.__name__.rpartition(".")[2]
    information = folder / f"{name}-1.dist-info"
    information.mkdir()
    metadata = ("Metadata-Version: 2.1", f"Name: {name.replace('_', '-')}", "Version: 1", "")
    (information / "METADATA").write_text("\n".join(metadata))
    (information / "entry_points.txt").write_text(f"[trajopt.problems]\ntests = {module.__name__}\n")


@contextmanager
def installed(module: ModuleType, folder: Path) -> Iterator[Path]:
    """The folder, on the path of this process, with that module as a package of problems."""
    install(module, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield folder


def offered(families: ModuleType) -> Callable[..., Iterator[Path]]:
    """A fixture of a file of tests: the folder that offers these families, beside those of the library."""

    @pytest.fixture(scope="module", autouse=True)
    def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
        with installed(families, tmp_path_factory.mktemp("package")) as folder:
            yield folder

    return package
