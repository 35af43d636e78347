"""The catalogue of the studies."""

import importlib
import inspect
from pathlib import Path

import pytest

import kneexo.studies
from kneexo.analysis.frequency.frequency_response import sinestream
from kneexo.studies.catalogue import FIGURES, FILES, STUDIES


@pytest.mark.parametrize("name", STUDIES)
def test_the_face_of_a_study_has_its_settings_and_its_function(name):
    face = importlib.import_module(f"kneexo.studies.{name}")
    assert STUDIES[name].settings is getattr(face, f"{name.capitalize()}Settings")
    assert STUDIES[name].compute is getattr(face, f"{name}_study")


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_each_stage_is_the_description_of_a_progress_bar(study):
    sources = [*(Path(kneexo.studies.__path__[0]) / study.name).glob("*.py")]
    sources.append(Path(inspect.getfile(sinestream)))
    text = "".join(path.read_text(encoding="utf-8") for path in sources)
    *bars, figures, files = [stage.name for stage in study.stages]
    assert (figures, files) == (FIGURES, FILES)
    assert [name for name in bars if f'"{name}"' not in text] == []
    assert study.duration_s == sum(stage.duration_s for stage in study.stages)


def test_motions_and_failed_runs_are_those_of_the_modules_that_have_them(monkeypatch):
    for name, place in (
        ("reproduce", "figures.motions"),
        ("size", "figures.motions"),
        ("robustness", "report.failed_runs"),
        ("contest", "report.failed_runs"),
    ):
        monkeypatch.setattr(f"kneexo.studies.{name}.{place}", lambda result: {"run": result})
        runs = getattr(STUDIES[name], place.partition(".")[2])
        assert runs(3) == {"run": 3}
    assert STUDIES["bandwidth"].motions(3) == STUDIES["bandwidth"].failed_runs(3) == {}
