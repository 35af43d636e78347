"""The catalogue: a study needs a template at least."""

import importlib
import inspect
import sys
from pathlib import Path

import pytest

import kneexo.studies
from kneexo.analysis.frequency_response import sinestream
from kneexo.studies import template
from kneexo.studies.catalogue import FIGURES, FILES, STUDIES, Study


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


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_each_stage_is_the_description_of_a_progress_bar(study):
    sources = [*(Path(kneexo.studies.__path__[0]) / study.name).glob("*.py")]
    sources.append(Path(inspect.getfile(sinestream)))
    text = "".join(path.read_text(encoding="utf-8") for path in sources)
    *bars, figures, files = [stage.name for stage in study.stages]
    assert (figures, files) == (FIGURES, FILES)
    assert [name for name in bars if f'"{name}"' not in text] == []
    assert study.duration_s == sum(stage.duration_s for stage in study.stages)
