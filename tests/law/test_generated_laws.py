"""Generated control laws: kneexo's form of a law gives the commands of the plain function."""

import importlib
import subprocess
import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from generated_laws import TERMS, generated_law

from kneexo.diagrams.signals import SIGNALS
from kneexo.parameters import SimulationParameters
from kneexo.simulation.run import Run

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
ALL_TERMS = {f"{group}: {name}" for group, names in TERMS.items() for name in names}


@pytest.fixture
def program(monkeypatch):
    """The module ``benchmarks/validate_laws.py``."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("validate_laws")


def law_with(feature):
    """A closure with a single term, or a form with a term that traces. A flag changes."""
    if feature in ALL_TERMS:
        laws = (generated_law(seed, form="closure", terms=[feature]) for seed in count())
    else:
        laws = (generated_law(seed, form=feature, terms=["equations: filter"]) for seed in count())
    if feature.startswith("truthiness"):
        return next(law for law in laws if "1.0 - state" in law.files["law.py"])
    return next(laws)


def made_up_run(samples=30):
    """A run whose signals cross zero and meet the thresholds of the terms."""
    time_s = 0.002 * np.arange(samples)
    random = np.random.default_rng(0)
    names = [name for columns in SIGNALS.values() for name in columns]
    data = {name: 3e-4 * random.standard_normal(samples) for name in names}
    return Run(time_s, data, SimulationParameters())


@pytest.mark.parametrize(
    "feature",
    [
        "truthiness: if",
        "truthiness: or",
        "truthiness: not",
        "truthiness: while",
        "truthiness: numpy.count_nonzero",
        "equations: if_then_else",
        "equations: bounded integral",
        "Python: swallowed error",
        "Python: two ways by type",
        "Python: text of state",
        "Python: hysteresis",
        "object with hidden state",
        "object with late hidden state",
        "imported modules",
    ],
)
def test_a_law_alone_gives_the_commands_of_its_function(program, tmp_path, feature):
    law, run = law_with(feature), made_up_run()
    for name in ("law", "plain"):
        (tmp_path / name).mkdir()
    scenario = program.scenario_of(law, tmp_path / "law")
    limit = scenario.command_limit_rad_s
    plain = program.replayed(law, tmp_path / "plain", run)[:-1, 0]
    assert np.ptp(plain) > 1.0
    np.testing.assert_allclose(
        program.alone(scenario, run) / limit,
        np.clip(plain, -limit, limit) / limit,
        rtol=0.0,
        atol=program.LAW_TOLERANCE,
    )


@pytest.mark.slow
def test_laws_in_a_session_and_by_drake():
    """In processes of their own, which have run no law before."""
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "validate_laws.py"), "--count", "10", "--processes", "1"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
