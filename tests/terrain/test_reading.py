"""Terrain of a line of text or a file."""

import json

import pytest

from trajopt.errors import InputError
from trajopt.terrain import FlatGround, PiecewiseTerrain
from trajopt.terrain.reading import read_terrain

STEPS = PiecewiseTerrain.steps([0.06, 0.0], 0.4, at=(0.5, 0.0))


@pytest.mark.parametrize(
    ("text", "terrain"),
    [
        ("steps:heights=[0.06,0.0],run=0.4", STEPS),
        ("stairs:rise=0.1,run=0.3,steps=3,at=[1,0]", PiecewiseTerrain.stairs(0.1, 0.3, 3, at=(1.0, 0.0))),
        ("box:height=0.1,length=0.4,width=1", PiecewiseTerrain.box(0.1, 0.4, 1.0, at=(0.7, 0.0))),
        ("gap:width=0.1", PiecewiseTerrain.gap(0.1, at=(0.5, 0.0))),
        (
            "stepping_stones:centres=[[0,0],[1,0]],size=0.3",
            PiecewiseTerrain.stepping_stones([(0, 0), (1, 0)], 0.3),
        ),
    ],
)
def test_a_text_names_a_constructor_and_its_arguments(text, terrain):
    assert read_terrain(text, 0.5).describe() == terrain.describe()


@pytest.mark.parametrize("terrain", [STEPS, FlatGround(friction=0.5)])
def test_a_file_has_the_description_of_a_terrain(terrain, tmp_path):
    file = tmp_path / "ground.json"
    file.write_text(json.dumps(terrain.describe()))
    assert read_terrain(str(file), 0.0).describe() == terrain.describe()


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "hills",
            "--terrain is 'hills'; allowed: steps, stairs, box, gap, slope, stepping_stones, FILE.json",
        ),
        ("stairs:rise=0.1", "--terrain 'stairs:rise=0.1' has the wrong form; allowed: stairs:NAME=VALUE"),
        ("stairs:rise=0.1,run=0.3,steps=3,tread=1", "has the wrong form; allowed: stairs:NAME=VALUE"),
        ("gap:width", "--terrain gap has 'width'; allowed: NAME=NUMBER"),
        ("gap:width=open('f')", "--terrain gap has 'width=open"),
        ("gap:width=-1", "width of "),
        ("missing.json", "missing.json cannot be read"),
    ],
)
def test_texts_that_do_not_fit_are_one_line(text, line):
    with pytest.raises(InputError) as error:
        read_terrain(text, 0.0)
    assert line in str(error.value)
    assert "\n" not in str(error.value)
