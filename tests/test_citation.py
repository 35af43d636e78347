"""The citation is true, and the changelog stays short."""

from __future__ import annotations

import re
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


def test_each_version_of_the_changelog_is_short():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    _, *versions = re.split(r"^## ", changelog, flags=re.MULTILINE)
    assert len(versions) >= 3
    assert [version[:20] for version in versions if len(version.encode()) > 7000] == []
