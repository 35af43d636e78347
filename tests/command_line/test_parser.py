import re
import subprocess

import pytest

from kneexo.command_line import arguments
from kneexo.command_line.main import main
from kneexo.parameters.presets import PRESETS
from kneexo.studies.catalogue import STUDIES

GROUPS = ("", "study", "setup", "export")
WITHOUT_ENGINE = ("linearize", "params", "diagram", "setup cache", "view", "export fmu")
COMMANDS = (*GROUPS, "simulate", *WITHOUT_ENGINE, *(study.command for study in STUDIES.values()))


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_only_defaults_that_tell_something(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit, match="0"):
        main([*command.split(), "--help"])
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 100
    words = " ".join(text.split())
    assert ("commands:" in text) == (command in GROUPS)
    assert ("--json" in text) == (command not in GROUPS)
    assert not re.search(r"default: (None|False|\[\])", words)
    assert ("--engine" in text) == (command not in (*GROUPS, *WITHOUT_ENGINE))
    takes = re.search(r"Takes about \d+ (s|min|h) on two cores\.", words)
    assert bool(takes) == (command not in GROUPS)
    shown = [name for name in PRESETS if f" {name} (" in words]
    assert shown == (list(PRESETS) if "--preset" in text else [])
    assert ("--preset" in text) == (command not in (*GROUPS, "setup cache", "reproduce"))


@pytest.mark.parametrize(
    ("duration_s", "text"),
    [
        (0.4, "1 s"),
        (89.0, "89 s"),
        (95.0, "2 min"),
        (5300.0, "88 min"),
        (9000, "2 h"),
    ],
)
def test_durations_are_rounded_to_a_unit_that_one_expects(duration_s, text):
    assert arguments.rounded(duration_s) == text


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_commands_and_options(shell, capsys):
    assert main(["setup", "completion", shell]) == 0
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
