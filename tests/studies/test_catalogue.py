"""The catalogue: a study needs a template at least."""

import importlib
import sys

import pytest

import kneexo.studies
from kneexo.studies import template
from kneexo.studies.catalogue import STUDIES, Study


@pytest.mark.parametrize("name", STUDIES)
def test_the_face_of_a_study_has_its_settings_and_its_function(name):
    face = importlib.import_module(f"kneexo.studies.{name}")
    assert STUDIES[name].settings is getattr(face, f"{name.capitalize()}Settings")
    assert STUDIES[name].compute is getattr(face, f"{name}_study")


def test_a_study_without_a_module_for_its_report_fills_its_template(tmp_path, monkeypatch):
    folder = tmp_path / "smallest"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "report.md").write_text("# {{ result.title }}\n")
    monkeypatch.setattr(kneexo.studies, "__path__", [*kneexo.studies.__path__, str(tmp_path)])
    loader = template._ENVIRONMENT.loader
    monkeypatch.setattr(loader, "searchpath", [*loader.searchpath, str(tmp_path)])
    try:
        assert Study("smallest", "smallest", "").report({"title": "Small"}) == "# Small\n"
    finally:
        sys.modules.pop("kneexo.studies.smallest", None)
