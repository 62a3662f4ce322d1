"""Generated pages of the site forget no public name, command or option; nothing comes from a network."""

import importlib
import re
from types import ModuleType

import click
import pytest

from scripts.site import gallery, reference
from tests.support.repository import ROOT
from trajopt.problem import families

PAGES = reference.python_pages()
COMMANDS = dict(reference.commands())


@pytest.mark.parametrize("module", sorted(reference.public_names()))
def test_every_public_name_has_its_entry(module: str) -> None:
    loaded = importlib.import_module(module)
    names = {name for name in loaded.__all__ if not isinstance(getattr(loaded, name), ModuleType)}
    page = PAGES[f"{reference.PYTHON}/{module}.md"]
    assert set(re.findall(rf"^::: {module}\.(\w+)$", page, re.MULTILINE)) >= names
    assert f"]({module}.md)" in PAGES[f"{reference.PYTHON}/index.md"]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_option_of_a_command_is_on_its_page(name: str) -> None:
    pages = reference.command_pages()
    page = pages[f"{reference.COMMANDS}/{name.removeprefix('trajopt ').replace(' ', '-')}.md"]
    options = [p for p in COMMANDS[name].params if isinstance(p, click.Option) and not p.hidden]
    for option in (word for parameter in options for word in parameter.opts):
        assert re.search(rf"`[^`]*{re.escape(option)}\b", page), option
    assert f"`{name}`" in pages[f"{reference.COMMANDS}/index.md"]


def test_every_parameter_of_every_problem_is_listed() -> None:
    (page,) = reference.problem_page().values()
    sections = dict(re.findall(r"^## `([\w-]+)`\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL))
    assert set(sections) == set(families())
    for name, family in families().items():
        listed = re.findall(r"^\| `(\w+)` \|", sections[name], re.MULTILINE)
        assert listed == [parameter.name for parameter in family.parameters], name


def test_nothing_of_the_site_comes_from_a_network() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert "http" not in text
    assert "font: false" in text
    assert re.search(r"^  - offline", text, re.MULTILINE)
    assets = [path for path in (ROOT / "docs/assets").rglob("*") if path.suffix in (".js", ".css")]
    assert {"katex.min.js", "katex.min.css", "iframe-worker.js"} <= {path.name for path in assets}
    for path in assets:
        assert not re.search(r"url\(\s*[\"']?https?:", path.read_text(encoding="utf-8")), path.name


def test_every_picture_of_the_gallery_opens_a_replay() -> None:
    text = (ROOT / "docs" / gallery.PAGE).read_text(encoding="utf-8")
    names = {name for _, name in gallery.PICTURE.findall(text)}
    linked = set(re.findall(r"\]\(([\w@.-]+)\.html\)", gallery.with_links(text)))
    assert linked == names
