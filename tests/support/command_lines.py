"""The command line in this process, and what every command does with bad input."""

from click.testing import CliRunner, Result

from trajopt.cli.commands import main


def invoke(*arguments: object) -> Result:
    """``trajopt`` with these arguments."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def assert_refused(result: Result, *words: str) -> None:
    """Exit status 2, nothing on stdout, one line on stderr that has all ``words``."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("trajopt: ")
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr
