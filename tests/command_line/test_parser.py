import re
import subprocess

import pytest

from kneexo.command_line.main import main
from kneexo.studies.catalogue import STUDIES

WITHOUT_ENGINE = ("linearize", "params", "diagram", "cache")


COMMANDS = [
    *("simulate", *WITHOUT_ENGINE),
    *(study.command for study in STUDIES.values()),
]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_only_defaults_that_tell_something(command, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([*command.split(), "--help"])
    text = capsys.readouterr().out
    assert "--json" in text
    assert not re.search(r"default:\s+(None|False|\[\])", text)
    assert ("--engine" in text) == (command not in WITHOUT_ENGINE)


def test_unknown_arguments_are_short_and_on_one_line(capsys):
    with pytest.raises(SystemExit):
        main(["params", "a", "b\n" + "x" * 5000])
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("kneexo: error: unrecognized arguments: b\\nxxx")
    assert len(line) < 1300


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_commands_and_options(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for word in ("reproduce", "robustness", "contest", "--uncertainty"[2:]):
        assert word in script
    if shell == "bash":
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)
        for line in (
            "_simulate_pos_0_COMPGEN=_shtab_compgen_files",
            "_view_pos_0_COMPGEN=_shtab_compgen_files",
            "_view___out_COMPGEN=_shtab_compgen_files",
            "_simulate___out_COMPGEN=_shtab_compgen_dirs",
            "_study_contest___out_COMPGEN=_shtab_compgen_dirs",
        ):
            assert line in script
