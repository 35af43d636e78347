import json
import os
from pathlib import Path

import pytest

import kneexo
from diagramc.native import cache
from kneexo.command_line.main import main
from kneexo.parameters import Scenario
from kneexo.parameters.scenario_file import load_scenario

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_params_prints_a_scenario_file_that_loads(capsys, tmp_path):
    assert main(["params", "--yaml"]) == 0
    path = tmp_path / "full.yaml"
    path.write_text(capsys.readouterr().out)
    assert load_scenario(path) == Scenario()


@pytest.mark.slow
def test_diagram_writes_the_loop_as_svg_and_png(capsys, scenario_file, tmp_path):
    path, out = scenario_file("controller: {kind: pid}"), tmp_path / "out"
    assert main(["diagram", path, "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"In {out}: closed_loop.png, closed_loop.svg\n"
    text = (out / "closed_loop.svg").read_text()
    assert "<!-- PID -->" in text
    assert '<g id="cylinder">' in text
    assert "estimator" not in text
    assert (out / "closed_loop.png").read_bytes()[:4] == b"\x89PNG"
    assert main(["diagram", path, "--out", str(tmp_path / "again"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == ["closed_loop.png", "closed_loop.svg"]
    assert (tmp_path / "again" / "closed_loop.svg").read_text() == text


def test_cache_shows_and_clears_what_is_kept(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("DIAGRAMC_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", "7")
    assert main(["setup", "cache"]) == 0
    assert "entries    0\n" in capsys.readouterr().out
    assert not (tmp_path / "cache").exists()
    for age_s in range(6):
        cache.store(str(age_s), bytes(2**20))
        used_last = cache.cache_entries()[0].path
        os.utime(used_last, (1e9 - age_s, 1e9 - age_s))
    newest, *_, oldest = cache.cache_entries()
    assert main(["setup", "cache", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["directory"] == str(tmp_path / "cache")
    assert printed["limit_bytes"] == 7 * 2**20
    assert printed["size_bytes"] == sum(entry["size_bytes"] for entry in printed["entries"])
    assert [entry["last_use_s"] for entry in printed["entries"]] == [1e9 - age for age in range(6)]
    assert printed["entries"][0]["name"] == newest.path.name
    assert main(["setup", "cache"]) == 0
    text = capsys.readouterr().out
    assert f"directory  {tmp_path / 'cache'}\nentries    6\n" in text
    assert "size       6.0 of at most 7 MiB" in text
    assert "2001-09-0" in text
    assert "1024.0 KiB" in text
    assert newest.path.name in text
    assert oldest.path.name not in text
    assert main(["setup", "cache", "--clear"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'cache'}: 6 entries deleted\n"
    assert list((tmp_path / "cache").iterdir()) == []
    cache.store("key", b"code")
    before = tmp_path / "cache" / f"{0:032x}.kneexo", tmp_path / "kneexo" / f"{1:032x}.kneexo"
    own = tmp_path / "kneexo" / "notes.kneexo"
    own.parent.mkdir()
    for file in (*before, own):
        file.write_bytes(b"")
    assert main(["setup", "cache", "--clear", "--json"]) == 0
    assert [file.exists() for file in (*before, own)] == [False, False, True]
    printed = json.loads(capsys.readouterr().out)
    assert printed == {
        "kneexo": kneexo.__version__,
        "directory": str(tmp_path / "cache"),
        "deleted": 3,
    }
