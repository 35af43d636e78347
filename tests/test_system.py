"""What the system must have, told in one line before anything else; README and Dockerfile."""

import re
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from kneexo import system
from kneexo.command_line.main import main

ROOT = Path(__file__).parents[1]
REMEDY = "Debian, Ubuntu (as root): apt-get update && apt-get install -y"


@pytest.fixture
def bare(monkeypatch):
    """A system without Drake's library."""
    monkeypatch.setattr(system, "LIBRARIES", {"libnot-there.so.0": "libnot-there0"})


def test_this_system_lacks_nothing():
    assert system.lacking() == ""
    done = subprocess.run(
        [sys.executable, "-I", "-S", ROOT / "kneexo" / "system.py"], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.usefixtures("bare")
@pytest.mark.parametrize(
    "arguments",
    [
        ["params"],
        *([*c, "--out", "out"] for c in (["reproduce"], ["study", "contest"], ["diagram"])),
    ],
)
def test_a_missing_library_is_one_line_and_nothing_is_written(
    arguments, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert capsys.readouterr() == (
        "",
        f"kneexo: this system lacks libnot-there.so.0; {REMEDY} libnot-there0\n",
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("bare")
def test_what_needs_no_drake_works_without_its_library(capsys):
    for arguments in (["params", "--yaml"], ["params", "--schema"], ["setup", "cache"]):
        assert main(arguments) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("bare")
def test_an_installation_lacks_venv_as_well(monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert system.main() == 2
    assert capsys.readouterr().err == (
        "kneexo: this system lacks libnot-there.so.0, ensurepip, venv; "
        f"{REMEDY} libnot-there0 python3-venv\n"
    )


def test_a_library_that_we_do_not_know_is_one_line_too(monkeypatch, capsys):
    text = "libx.so.1: cannot open shared object file: No such file or directory"
    monkeypatch.setattr("kneexo.command_line.utilities.params", Mock(side_effect=ImportError(text)))
    assert main(["params"]) == 2
    message = "kneexo: this system lacks libx.so.1; install the package that has it\n"
    assert capsys.readouterr().err == message


def test_another_import_error_is_raised(monkeypatch):
    monkeypatch.setattr(
        "kneexo.command_line.utilities.params", Mock(side_effect=ImportError("no name 'x'"))
    )
    with pytest.raises(ImportError, match="name 'x'"):
        main(["params"])


def test_the_dockerfile_runs_the_commands_of_the_readme_and_of_the_install_page():
    pages = ("docs/install.md", "README.md", "Dockerfile")
    install, readme, dockerfile = ((ROOT / name).read_text("utf-8") for name in pages)
    commands = re.findall(r"^apt-get .*$", install, re.MULTILINE)
    commands += re.findall(r"^python3 .*$", readme, re.MULTILINE)
    commands = [c for c in commands if not re.search("sphinx-build|kneexo play", c)]
    assert re.findall(r"^RUN (.*)$", dockerfile, re.MULTILINE) == commands
    assert commands[0].split() == [*REMEDY.split()[4:], "python3-venv", *system.LIBRARIES.values()]
