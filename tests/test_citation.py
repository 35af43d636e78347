"""The citation is true."""

from __future__ import annotations

from pathlib import Path

import yaml

import kneexo

ROOT = Path(__file__).parents[1]


def test_the_citation_names_version_and_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == kneexo.__version__
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## {kneexo.__version__} ({citation['date-released']})" in changelog
    (paper,) = citation["references"]
    names = [author["family-names"] for author in paper["authors"]]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert names == ["Lee", "Lee", "Song", "Baek"]
    where = "{journal} {year}, {volume}({issue}), {start}".format(**paper)
    assert f"*{paper['title']}* ([{where}](https://doi.org/{paper['doi']}))" in readme
