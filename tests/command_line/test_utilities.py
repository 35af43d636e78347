import json
import os
import re
from pathlib import Path

import pytest

import kneexo
from diagramc.native import cache
from kneexo.command_line.main import main

EXAMPLES = Path(__file__).parents[2] / "examples"


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


def test_cache_shows_and_clears_what_is_kept(capsys, tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    monkeypatch.setenv("DIAGRAMC_CACHE_DIR", str(folder))
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", "7")

    def answer(*words):
        assert main(["setup", "cache", *words]) == 0
        return capsys.readouterr().out

    assert "entries    0\n" in answer()
    assert not folder.exists()
    for age_s in range(6):
        cache.store(str(age_s), bytes(2**20))
        used_last = cache.cache_entries()[0].path
        os.utime(used_last, (1e9 - age_s, 1e9 - age_s))
    newest, *_, oldest = cache.cache_entries()
    printed = json.loads(answer("--json"))
    assert printed["directory"] == str(folder)
    assert printed["limit_bytes"] == 7 * 2**20
    assert printed["size_bytes"] == sum(entry["size_bytes"] for entry in printed["entries"])
    assert [entry["last_use_s"] for entry in printed["entries"]] == [1e9 - age for age in range(6)]
    assert printed["entries"][0]["name"] == newest.path.name
    text = answer()
    assert f"directory  {folder}\nentries    6\nsize       6.0 of at most 7 MiB\n" in text
    assert re.search(rf"  2001-09-0\d \d\d:\d\d    1024.0 KiB  {newest.path.name}\n", text)
    assert oldest.path.name not in text
    assert answer("--clear") == f"{folder}: 6 entries deleted\n"
    assert list(folder.iterdir()) == []
    cache.store("key", b"code")
    before = folder / f"{0:032x}.kneexo", tmp_path / "kneexo" / f"{1:032x}.kneexo"
    own = tmp_path / "kneexo" / "notes.kneexo"
    own.parent.mkdir()
    for file in (*before, own):
        file.write_bytes(b"")
    document = {"kneexo": kneexo.__version__, "directory": str(folder), "deleted": 3}
    assert json.loads(answer("--clear", "--json")) == document
    assert [file.exists() for file in (*before, own)] == [False, False, True]
