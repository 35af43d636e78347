"""The exported controller on emulated microcontrollers: `benchmarks/processor.py`."""

import importlib
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow  # compilers, analysers and emulators

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
FULL_SPEED = 5000.0 * 2.0 * math.pi / 60.0
TOLERANCES = {"double": 1e-12 * FULL_SPEED, "float": FULL_SPEED / 5000.0}
TOLERANCES["float, table"] = 0.1 * TOLERANCES["float"]
MOST = {  # instructions of a step; an M4F computes double by software
    ("Cortex-M4F", "float"): 1_000,
    ("Cortex-M4F", "float, table"): 400,
    ("Cortex-M4F", "double"): 25_000,
    ("Cortex-M7", "float"): 1_000,
    ("Cortex-M7", "double"): 1_000,
}
CASES = [
    ("Cortex-M4F", "SMC", "float"),
    ("Cortex-M4F", "SMC", "float, table"),
    ("Cortex-M4F", "SMC", "double"),
    ("Cortex-M4F", "PID", "float"),
    ("Cortex-M7", "SMC", "float"),
    ("Cortex-M7", "SMC", "double"),
    ("Cortex-M4F", "torque", "float"),
]


@pytest.fixture
def processor(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    module = importlib.import_module("processor")
    try:
        module.require_tools()
    except module.MissingToolError as error:
        pytest.skip(str(error))
    return module


@cache
def measured(module, name, controller, precision):
    (chosen,) = (p for p in module.PROCESSORS if p.name == name)
    return module.figures(module.SCENARIOS[controller], precision, chosen)


def test_a_stiff_plant_runs_on_the_processor(processor):
    """In double, with the Rosenbrock method; RK4 at its largest stable step takes 83,000."""
    figures = processor.figures(processor.LEG, "double", processor.M7, **processor.STIFF_PLANT)
    assert figures.failures == 0
    assert 0.0 < figures.difference <= 1e-6 * processor.LEG.plant.cylinder.stroke_m
    assert 5_000 < figures.mean <= figures.largest <= 25_000
    assert figures.stack_bytes < 4_000


@pytest.mark.parametrize(("name", "controller", "precision"), CASES)
def test_the_controller_runs_on_the_processor(processor, name, controller, precision):
    figures = measured(processor, name, controller, precision)
    assert figures.failures == 0
    assert 0.0 < figures.difference <= TOLERANCES[precision]
    assert figures.hundred == pytest.approx(100.0, abs=1.5)  # a tick is 0.6 of it
    assert 100.0 < figures.mean <= figures.largest <= MOST[name, precision]
    assert 40 < figures.stack_bytes < 500
    assert 4_000 < figures.flash_bytes < 20_000


def test_the_state_is_that_of_the_structs(processor):
    # d[4], lost[3], c[22], the last outputs, whether it is started, and the outputs.
    figures = measured(processor, "Cortex-M4F", "SMC", "float")
    assert figures.state_bytes == 4 * (4 + 3 + 22 + 1 + 1 + 1)


def test_the_share_of_the_sample_time_has_its_units(processor):
    figures = replace(measured(processor, "Cortex-M4F", "SMC", "float"), largest=1_680.0)
    assert figures.share(processor.M4F, 2e-3) == pytest.approx(0.01)  # 20 µs of 2 ms


def test_a_missing_tool_is_named(processor, monkeypatch):
    monkeypatch.setattr(processor, "QEMU", "no-such-emulator")
    with pytest.raises(processor.MissingToolError, match=r"^no-such-emulator: not installed$"):
        processor.require_tools()


def test_the_table_has_its_units(processor, monkeypatch, capsys):
    figures = processor.Figures(
        failures=0,
        difference=2.0 * math.pi / 60.0,
        hundred=100.0,
        mean=700.0,
        largest=1_680.0,
        stack_bytes=152,
        state_bytes=124,
        flash_bytes=10_800,
    )
    monkeypatch.setattr(processor, "figures", lambda *_, **__: figures)
    processor.main()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 2 * (3 * 3 + 2)
    assert lines[1] == ("Cortex-M4F, 168 MHz | SMC | float | 1 | 700, 1680 | 1 % | 152, 124 | 10.8")
