import functools
import subprocess
import sys
from dataclasses import replace

import pytest

from kneexo.parameters import Scenario
from kneexo.studies.catalogue import STUDIES, Presentation


@pytest.fixture
def scenario_file(tmp_path):
    """The function ``scenario_file(text)``: writes a scenario file and returns its path."""

    def write(text):
        path = tmp_path / "scenario.yaml"
        path.write_text(text)
        return str(path)

    return write


@pytest.fixture
def short(scenario_file):
    """A scenario file of a short run."""
    return scenario_file(
        "reference: {frequency_hz: 1.0, amplitude_deg: 2.0}\nsimulation: {duration_s: 1.2}\n"
    )


@pytest.fixture
def undrawn(monkeypatch):
    """Draw no figures, which take longer than the rest and have tests of their own."""
    monkeypatch.setattr("kneexo.studies.bandwidth.figures.figures", lambda _: {})
    monkeypatch.setattr("kneexo.command_line.output.save_figure", lambda *_: None)


@pytest.fixture
def run_command():
    """The function ``run_command(*arguments, **options)``: runs kneexo in a process."""

    def run(*arguments, **options):
        line = [sys.executable, "-m", "kneexo", *arguments]
        return subprocess.run(line, stderr=subprocess.PIPE, text=True, **options)

    return run


class FakeResult:
    """The result of a study that computes nothing."""

    def results(self):
        return {"results": "of the study"}


@pytest.fixture
def replace_study(monkeypatch):
    """The function ``replace_study(name, compute, **shows)``: a study that calls ``compute``.

    ``shows`` are functions of its `Presentation`.
    """

    def replaced(name, compute, **shows):
        @functools.wraps(compute)
        def study(*arguments, **options):
            compute(*arguments, **options)
            return FakeResult()

        row = STUDIES[name]
        computation = replace(row.computation(), compute=study)
        shown = Presentation(lambda result: "# report\n", lambda result: {}, **shows)
        row = replace(row, computation=lambda: computation, presentation=lambda: shown)
        monkeypatch.setitem(STUDIES, name, row)

    return replaced


@pytest.fixture
def stand_in(replace_study):
    """The function ``stand_in(compute)``: the bandwidth study calls ``compute(checkpoint)``."""

    def replace(compute):
        def study(scenario=Scenario(), *, settings, checkpoint, **_):
            compute(checkpoint)

        replace_study("bandwidth", study)

    return replace
