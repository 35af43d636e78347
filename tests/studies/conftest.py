"""Shared by the tests of studies: what a row must hold, from runs and margins without a study."""

import importlib
import math
from functools import cache
from unicodedata import combining

import numpy as np
import pytest

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.command_line.plain_text import head_of, plain_text
from kneexo.simulation.engines import simulate
from kneexo.studies.catalogue import STUDIES
from kneexo.sweeps.checkpoint import Checkpoint


def _in_numbers(scenario, period_s):
    run = simulate(
        scenario, signals=("knee_reference", "knee_angle", "motor_speed_command", "load_pressure")
    )
    late = run.time_s > (period_s if run.time_s[-1] > 2.0 * period_s - 2.001e-3 else 0.0) - 1e-6
    error = np.degrees(run["knee_reference_rad"] - run["knee_angle_rad"])[late]
    command = run["motor_speed_command_rad_s"]
    return {
        "max_error_deg": np.max(np.abs(error)),
        "rms_error_deg": np.sqrt(np.mean(error**2)),
        "mean_command_change_rpm": np.mean(np.abs(np.diff(command[late]))) * 30.0 / math.pi,
        "saturated_share": np.mean(np.abs(command) > 523.598),  # of 5000 rpm
        "peak_pressure_mpa": np.max(np.abs(run["load_pressure_pa"])) / 1e6,
    }


def _margins(scenario, angle_deg):
    loop = linearize_loop(scenario, knee_angle_deg=angle_deg)
    names = ("phase_margin_deg", "delay_margin_s", "gain_margin", "disk_margin")
    values = loop.margins() if loop.stable else None
    return {"stable": float(loop.stable)} | {
        name: getattr(values, name, math.nan) for name in names
    }


def _cases(name):
    return importlib.import_module(f"{name}_cases")


@pytest.fixture
def by_hand(request):
    """The result of the study of the test's folder that is made up, without a run."""
    return _cases(request.path.parent.name).made_up()


@pytest.fixture(scope="session")
def computed(tmp_path_factory):
    """The function ``computed(name)``: result of a small study, and path of its checkpoint."""

    @cache
    def compute(name):
        path = tmp_path_factory.mktemp(name) / "checkpoint.jsonl"
        study = STUDIES[name].computation()
        return study.compute(**_cases(name).SMALL_STUDY, checkpoint=Checkpoint(path)), path

    return compute


@pytest.fixture
def small(request, computed):
    """Result and path of the checkpoint of the small study of the test's folder."""
    return computed(request.path.parent.name)


@pytest.fixture(scope="session")
def rows_of(tables):
    """The function ``rows_of(report)``: from the first cell of each row of tables to the others."""
    return lambda report: {name: cells for table in tables(report) for name, *cells in table}


@pytest.fixture(scope="session")
def in_numbers():
    """The function ``in_numbers(scenario, period_s)``: a run by NumPy, from its 2nd period on."""
    return _in_numbers


@pytest.fixture(scope="session")
def margins():
    """The function ``margins(scenario, angle_deg)``: of the sampled loop; nan if unstable."""
    return _margins


@pytest.fixture(scope="session")
def check_screen():
    """The function ``check_screen(report)``: the lines that the command prints about a study."""

    def check(report, most=18):
        lines = plain_text(head_of(report)).splitlines()
        assert 5 <= len(lines) <= most  # an empty line and the files follow
        assert max(sum(not combining(letter) for letter in line) for line in lines) <= 100
        assert lines[0] == report.splitlines()[0].removeprefix("# ")
        assert "\x1b" not in "".join(lines)
        return lines

    return check
