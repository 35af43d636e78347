"""The vendored libraries are what npm has."""

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import kneexo.view

VENDOR = Path(kneexo.view.__file__).parent / "web/vendor"
MAKE = Path(__file__).parents[3] / ".ci/vendor"


def test_each_file_has_its_hash_and_nothing_else_lies_there():
    record = json.loads((VENDOR / "vendor.json").read_text(encoding="utf-8"))
    for name, item in record["files"].items():
        assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == item["sha256"], name
    others = {"vendor.json", *(i["bundle"] for i in record["files"].values() if "bundle" in i)}
    assert {path.name for path in VENDOR.iterdir()} == {*record["files"], *others}


@pytest.mark.slow
@pytest.mark.cases_in_gate(0)  # needs npm's registry
def test_npm_makes_the_same_files(tmp_path):
    if not (shutil.which("npm") and MAKE.exists()):
        pytest.skip("needs npm and .ci/vendor")
    reachable = subprocess.run(["npm", "ping"], capture_output=True).returncode == 0
    if not reachable:
        pytest.skip("needs the registry of npm")
    subprocess.run([sys.executable, MAKE, tmp_path], check=True)
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (VENDOR / path.name).read_bytes(), path.name
    assert len(list(tmp_path.iterdir())) == 6
