"""The vendored libraries are what `.ci/vendor` has made from npm."""

import hashlib
import json
from pathlib import Path

import pytest

import kneexo.view


@pytest.mark.parametrize(
    "folder",
    [
        Path(kneexo.view.__file__).parent / "web/vendor",
        Path(__file__).parents[2] / "page/web/vendor",
    ],
    ids=["pages", "tests"],
)
def test_each_file_has_its_hash_and_nothing_else_lies_there(folder):
    record = json.loads((folder / "vendor.json").read_text(encoding="utf-8"))
    for name, item in record["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == item["sha256"], name
    others = {"vendor.json", *(i["bundle"] for i in record["files"].values() if "bundle" in i)}
    assert {path.name for path in folder.iterdir()} == {*record["files"], *others}
