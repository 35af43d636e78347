"""What is shipped: the source distribution is complete, and the citation is true."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
import yaml

import kneexo

ROOT = Path(__file__).parents[1]


def test_the_citation_names_version_and_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == kneexo.__version__
    (paper,) = citation["references"]
    names = [author["family-names"] for author in paper["authors"]]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert names == ["Lee", "Lee", "Song", "Baek"]
    assert f"*{paper['title']}* ({paper['journal']}, {paper['year']})" in readme


@pytest.mark.slow
def test_the_source_distribution_is_complete(tmp_path):
    """All that is under version control, but for what serves the repository alone."""
    listed = subprocess.run(["git", "-C", ROOT, "ls-files"], capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no repository here")
    tools = tmp_path / "tools"
    install = [sys.executable, "-m", "pip", "install", "-q", "--target", tools, "setuptools>=77"]
    if subprocess.run(install, capture_output=True).returncode:
        pytest.skip("setuptools cannot be had offline")
    source = tmp_path / "source"
    subprocess.run(["git", "-C", ROOT, "checkout-index", "-a", f"--prefix={source}/"], check=True)
    build = f"import sys; sys.path.insert(0, {str(tools)!r}); import setuptools.build_meta as b; "
    build += f"b.build_sdist({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    (archive,) = tmp_path.glob("kneexo-*.tar.gz")
    with tarfile.open(archive) as files:
        names = {name.partition("/")[2] for name in files.getnames()}
    wanted = {name for name in listed.stdout.splitlines() if not name.startswith(".")}
    assert wanted - names == set()
    assert [name for name in names if name.endswith((".pyc", "__pycache__"))] == []
