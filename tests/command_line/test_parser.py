import re
import subprocess

import pytest

from kneexo.command_line import arguments
from kneexo.command_line.main import main
from kneexo.studies.catalogue import STUDIES

WITHOUT_ENGINE = ("linearize", "params", "diagram", "setup cache")


COMMANDS = [
    *("simulate", *WITHOUT_ENGINE),
    *(study.command for study in STUDIES.values()),
]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_only_defaults_that_tell_something(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit, match="0"):
        main([*command.split(), "--help"])
    text = capsys.readouterr().out
    assert "--json" in text
    assert not re.search(r"default:\s+(None|False|\[\])", text)
    assert ("--engine" in text) == (command not in WITHOUT_ENGINE)
    assert max(map(len, text.splitlines())) <= 100
    assert re.search(r"Takes\sabout\s\d+\s(s|min|h)\son\stwo\scores\.", text)


@pytest.mark.parametrize("command", [[], ["study"], ["setup"], ["export"]])
def test_help_of_groups_has_at_most_100_columns(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit, match="0"):
        main([*command, "--help"])
    text = capsys.readouterr().out
    assert "commands:" in text
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.parametrize(
    ("duration_s", "text"),
    [
        (0.4, "1 s"),
        (4.4, "4 s"),
        (89.0, "89 s"),
        (95.0, "2 min"),
        (5300.0, "88 min"),
        (9000, "2 h"),
    ],
)
def test_durations_are_rounded_to_a_unit_that_one_expects(duration_s, text):
    assert arguments._rounded(duration_s) == text


def line_of(words, capsys):
    """The only line that wrong words print."""
    with pytest.raises(SystemExit, match="2"):
        main(words)
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    return line


def test_unknown_arguments_are_short_and_on_one_line(capsys):
    line = line_of(["params", "a", "b\n" + "x" * 5000], capsys)
    assert line.startswith("kneexo: b\\nxxx")
    assert line.endswith(": unknown argument; see kneexo params --help")
    assert len(line) < 1300


@pytest.mark.parametrize(
    ("command", "line"),
    [
        ("bandwidth --out o", "'kneexo bandwidth' is now 'kneexo study bandwidth'; see kneexo"),
        ("robustness", "'kneexo robustness' is now 'kneexo study robustness'; see kneexo"),
        ("cache --clear", "'kneexo cache' is now 'kneexo setup cache'; see kneexo"),
        ("completion bash", "'kneexo completion' is now 'kneexo setup completion'; see kneexo"),
        (
            "study bandwidth --out o --resume",
            "--resume is gone: a study always goes on from finished pieces without --restart; "
            "see kneexo study bandwidth",
        ),
        (
            "export cc --out o",
            "argument FORM: 'cc' is unknown; did you mean c?; known: c, sil, fmu; "
            "see kneexo export",
        ),
        ("setup", "the following arguments are required: PART; see kneexo setup"),
        (
            "setup completion fish",
            "argument shell: 'fish' is unknown; known: bash, zsh, tcsh; "
            "see kneexo setup completion",
        ),
    ],
)
def test_wrong_and_old_words_are_one_line_with_the_remedy(capsys, command, line):
    assert line_of(command.split(), capsys) == f"kneexo: {line} --help"


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
