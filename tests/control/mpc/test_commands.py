"""Scripts of commands: what they say at a time, and files that are refused in one line."""

from pathlib import Path

import pytest

from trajopt.control.mpc.commands import Command, CommandScript, read_commands
from trajopt.errors import InputError

GAITS = ("trot", "walk")


def test_a_command_holds_until_the_next() -> None:
    slow, fast = Command(gait="trot", speed=0.2), Command(gait="trot", speed=0.6)
    script = CommandScript((0.0, 1.0, 2.5), (Command(), slow, fast))
    given = {t: script.at(t) for t in (0.0, 0.999, 1.0, 2.49, 2.5, 99.0)}
    assert given == {0.0: Command(), 0.999: Command(), 1.0: slow, 2.49: slow, 2.5: fast, 99.0: fast}


def test_an_empty_field_keeps_the_value_before(tmp_path: Path) -> None:
    file = tmp_path / "commands.csv"
    file.write_text("time, gait, speed, turn_rate\n0,,,\n0.5, trot, 0.4,\n\n1.5,,, -0.3\n2,stand,0,0\n")
    script = read_commands(str(file), GAITS)
    assert script.times == (0.0, 0.5, 1.5, 2.0)
    assert script.commands == (
        Command(),
        Command(gait="trot", speed=0.4),
        Command(gait="trot", speed=0.4, turn_rate=-0.3),
        Command(turn_rate=0.0),
    )


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "has no column 'time', or no line below it; allowed: time, and any of gait, speed"),
        ("time,speed\n", "has no column 'time', or no line below it"),
        ("speed\n0.1\n", "has no column 'time', or no line below it"),
        ("time,sped\n0,1\n", "has the column 'sped'; allowed: time, and any of gait, speed, lateral"),
        ("time,speed,speed\n0,1,1\n", "has the column 'speed' twice"),
        ("time,speed\n0,1\n0.5,nan\n", "line 3: speed is 'nan'; allowed: a finite number"),
        ("time,speed\n0,1\n\n0.5,quick\n", "line 4: speed is 'quick'; allowed: a finite number"),
        ("time,speed\n0,1\ninf,1\n", "line 3: time is 'inf'; allowed: a finite number"),
        ("time,speed\n0,1\n,1\n", "line 3: time is ''; allowed: a finite number"),
        ("time,speed\n0.1,1\n", "line 2: time is 0.1; allowed: the first 0, then increasing, s"),
        ("time,speed\n0,1\n1,1\n1,2\n", "line 4: time is 1; allowed: the first 0, then increasing, s"),
        ("time,speed\n0,1,2\n", "line 2 has another number of fields; allowed: 2"),
        ("time,speed\n0\n", "line 2 has another number of fields; allowed: 2"),
        ("time,gait\n0,moonwalk\n", "line 2: gait is 'moonwalk'; allowed: stand, trot, walk"),
    ],
)
def test_a_wrong_file_is_one_line(text: str, line: str, tmp_path: Path) -> None:
    file = tmp_path / "commands.csv"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        read_commands(file, GAITS)
    assert str(refused.value).startswith(str(file))
    assert line in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_is_no_text_file_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "binary.csv").write_bytes(bytes(range(128, 256)))
    for name, why in (
        ("missing.csv", "No such file or directory"),
        (".", "Is a directory"),
        ("binary.csv", "no text"),
    ):
        with pytest.raises(InputError, match=f"cannot be read: .*{why}; allowed: a CSV file of commands"):
            read_commands(tmp_path / name, GAITS)


@pytest.mark.parametrize(
    ("times", "count", "line"),
    [
        ((), 0, "a script has 0 times and 0 commands; allowed: as many, one or more"),
        ((0.0, 1.0), 1, "a script has 2 times and 1 commands"),
        ((0.5,), 1, "a script: time is 0.5; allowed: the first 0"),
        ((0.0, 1.0, 1.0), 3, "a script: time is 1; allowed: the first 0, then increasing"),
        ((0.0, float("nan")), 2, "times[1] of CommandScript is nan"),
    ],
)
def test_a_wrong_script_is_one_line(times: tuple[float, ...], count: int, line: str) -> None:
    with pytest.raises(InputError) as refused:
        CommandScript(times, (Command(),) * count)
    assert line in str(refused.value)


def test_commands_are_finite_numbers() -> None:
    with pytest.raises(InputError, match="speed of Command is nan; allowed: a finite number"):
        Command(speed=float("nan"))
