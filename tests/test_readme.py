"""What README.md shows must run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from kneexo.cli import main
from kneexo.scenario import load_scenario

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def block(language):
    (text,) = re.findall(rf"^```{language}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
    return text


def test_the_scenario_file_loads(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(block("yaml"), encoding="utf-8")
    assert load_scenario(path).controller.kind == "pid"


@pytest.mark.parametrize("command", re.findall(r"^\| `kneexo (\w+)", README, re.MULTILINE))
def test_every_command_of_the_table_has_help(command, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    assert "--json" in capsys.readouterr().out


def test_every_linked_file_exists():
    root = Path(__file__).parents[1]
    targets = [t for t in re.findall(r"\]\(([^)]+)\)", README) if "://" not in t]
    assert targets
    assert [t for t in targets if not (root / t).exists()] == []


@pytest.mark.slow
def test_the_python_example_runs_in_an_empty_directory(tmp_path):
    code = "import matplotlib; matplotlib.use('Agg')\n" + block("python")
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True)
    assert (tmp_path / "tracking.png").stat().st_size > 10_000
