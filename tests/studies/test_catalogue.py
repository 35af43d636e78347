"""The catalogue of the studies."""

import subprocess
import sys
from importlib import import_module
from inspect import getfile, signature
from pathlib import Path

import pytest

import kneexo.studies
from kneexo.analysis.frequency.frequency_response import sinestream
from kneexo.studies.catalogue import STUDIES, Presentation

HERE = Path(kneexo.studies.__path__[0])


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_the_catalogue_has_each_function_that_a_study_defines(study):
    folder = f"kneexo.studies.{study.name}"
    modules = [vars(import_module(f"{folder}.{name}")) for name in ("report", "figures")]
    for field, function in vars(study.presentation()).items():
        defined = [module[field] for module in modules if field in module]
        left_out = getattr(Presentation, field, None)
        assert defined == ([] if function is left_out else [function])
    settings = signature(study.computation().compute).parameters["settings"].default
    assert type(settings) is study.computation().settings


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_each_stage_is_the_description_of_a_progress_bar(study):
    sources = [*(HERE / study.name).glob("*.py"), Path(getfile(sinestream))]
    text = "".join(path.read_text(encoding="utf-8") for path in sources)
    assert [stage.name for stage in study.stages if f'"{stage.name}"' not in text] == []


ALONE = """
import sys
from importlib import import_module
import_module(sys.argv[1])
assert not {"kneexo.studies.catalogue", "kneexo.command_line"} & set(sys.modules)
"""


@pytest.mark.slow
@pytest.mark.parametrize("module", ["report", "figures"])
@pytest.mark.parametrize("name", STUDIES)
def test_each_study_is_imported_alone(name, module):
    words = [sys.executable, "-c", ALONE, f"kneexo.studies.{name}.{module}"]
    subprocess.run(words, check=True)
