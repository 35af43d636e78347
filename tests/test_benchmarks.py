"""The hand-written programs and the peers of ``benchmarks/compare.py`` compute the same run."""

import importlib
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import simulate_compiled
from kneexo.studies.paper import PID_TUNED

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
STEPS, SAMPLES = 10, 100  # of RK4 in a sample; samples of 2 ms

WEIGHT = {
    "plant.load": {
        "kind": "knee",
        "knee_torque_n_m": 3.0,
        "disturbance_n": -5.0,
        "disturbance_amplitude_n": 20.0,
        "disturbance_frequency_hz": 30.0,
    },
    "plant.cylinder.stiffness_n_per_m": 100.0,
    "plant.cylinder.leakage_m3_per_s_pa": 1e-13,
}
LAW = {
    "controller.stiffness_uncertainty_n_per_m": 50.0,
    "controller.damping_uncertainty_n_s_per_m": 2.0,
    "controller.load_rate_uncertainty_n_per_s": 30.0,
    "controller.area_uncertainty": 0.1,
}
PID = {"controller": PID_TUNED.model_dump() | {"derivative": 0.02}}
FAST = {"reference.frequency_hz": 5.0, "reference.amplitude_deg": 2.0}  # meets the speed limit
QUANTIZED = {"encoder.quantized": True}
FREE = {"encoder.quantized": False}


@pytest.fixture
def load(monkeypatch):
    """Imports a module of the benchmarks."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module


def in_kneexo(scenario, integrator="rk4"):
    run = simulate_compiled(
        changed(scenario, {"simulation.duration_s": SAMPLES * 2e-3}),
        signals=("rod_extension", "load_pressure"),
        integrator=integrator,
        step_s=2e-3 / STEPS,
    )
    return np.column_stack([run["rod_extension_m"], run["load_pressure_pa"]])


def relative_difference(record, expected):
    return np.max(np.abs(record - expected) / np.abs(expected).max(axis=0))


def options(scenario):
    return {
        "pid": scenario.controller.kind == "pid",
        "loaded": scenario.plant.load.kind == "knee",
        "steps": STEPS,
        "samples": SAMPLES,
    }


@pytest.mark.parametrize(
    "encoder",
    [
        pytest.param(FREE, id="free", marks=pytest.mark.slow),
        pytest.param(QUANTIZED, id="quantized"),
    ],
)
@pytest.mark.parametrize(
    "values",
    [{}, WEIGHT | LAW, PID, PID | WEIGHT | FAST],
    ids=["smc", "smc_load", "pid", "pid_load"],
)
def test_c_agrees_with_the_compiled_model(load, values, encoder):
    hand_written = load("hand_written")
    try:
        hand_written.c_compiler()
    except hand_written.NoCompilerError:
        pytest.skip("no C compiler")
    scenario = changed(Scenario(), values | encoder)
    record = hand_written.run_c(hand_written.parameters_of(scenario), **options(scenario))
    # Both round, in another order; the 447 Hz mode rings on but does not amplify.
    assert relative_difference(record, in_kneexo(scenario)) < 1e-9


def test_functions_of_the_peers_agree_with_the_compiled_model(load):
    p = load("hand_written").parameters_of(changed(Scenario(), PID | FREE))
    loop = load("peers.simple_loop")
    x, z = (np.array(values) for values in loop.start(p))
    record = [x]
    h = p.sample_time_s / STEPS
    for sample in range(SAMPLES):
        command, z = loop.update(p, sample * p.sample_time_s, x, z)
        for _ in range(STEPS):
            k_1 = np.array(loop.derivatives(p, x, command))
            k_2 = np.array(loop.derivatives(p, x + 0.5 * h * k_1, command))
            k_3 = np.array(loop.derivatives(p, x + 0.5 * h * k_2, command))
            k_4 = np.array(loop.derivatives(p, x + h * k_3, command))
            x = x + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        record.append(x)
    ours = np.array(record)[:, [loop.EXTENSION, loop.PRESSURE]] * [1.0, 1e6]
    assert relative_difference(ours, in_kneexo(changed(Scenario(), PID | FREE))) < 1e-9


@pytest.mark.parametrize(
    ("values", "part"),
    [
        ({"reference.ramp_s": 1.0}, "ramp"),
        ({"bus.latency_samples": 1}, "latency"),
        ({"plant.full_order": {}}, "full order"),
        ({"controller.switching": "signum"}, "signum"),
        ({"estimator": {"kind": "exact"}}, "estimator"),
        ({"encoder.phase_rad": 1e-3}, "shifted counts"),
        ({"controller": {"kind": "pid", "velocity_feedforward": 1.0}}, "feedforward"),
    ],
)
def test_what_is_not_written_by_hand_is_refused(load, values, part):
    with pytest.raises(ValueError, match=part):
        load("hand_written").parameters_of(changed(Scenario(), values))


def test_without_a_c_compiler_the_row_says_so(load, monkeypatch):
    hand_written = load("hand_written")
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(hand_written.NoCompilerError, match="no C compiler"):
        hand_written.c_compiler()


@pytest.mark.slow
def test_the_exported_loop_is_measured_against_c_by_hand(load, monkeypatch, capsys):
    speed, hand_written = load("exported_speed"), load("hand_written")
    try:
        compiler = Path(hand_written.c_compiler()).name
    except hand_written.NoCompilerError:
        pytest.skip("no C compiler")
    monkeypatch.setattr(speed, "COMMANDS", (f"{compiler} -O1", "no-such-compiler -O2"))
    monkeypatch.setattr(speed, "CASES", {"weight": speed.CASES["with the weight"]})
    monkeypatch.setattr(speed, "LIMIT", math.inf)
    # A shorter run may take less than the clock of the C program resolves.
    assert speed.main(["--duration", "20", "--turns", "1"]) == 0
    _, line = capsys.readouterr().out.splitlines()
    assert line.startswith(f"weight | {compiler} -O1 | ")


@pytest.mark.parametrize(
    ("exported_s", "difference", "met"),
    [(1.09, 1e-10, True), (1.11, 1e-10, False), (1.0, 1e-8, False), (1.0, math.nan, False)],
)
def test_an_exported_loop_must_be_fast_and_right(load, exported_s, difference, met):
    row = load("exported_speed").Row("case", "cc", 1.0, exported_s, difference)
    assert row.met is met


def test_targets_are_judged_by_the_rows(load, monkeypatch):
    compare = load("compare")
    monkeypatch.setattr(compare, "FASTER_THAN_C", {"case": 3.0})
    rk4, _, hold = compare.KNEEXO
    wrapped, idiomatic = compare.DRAKE

    def row(way, time_s, **figures):
        return compare.Row("case", way.name, time_s, time_s / 0.01, rk4=way.rk4, **figures)

    rows = [
        row(compare.C, 0.01, difference=1e-12),
        row(rk4, 0.02, difference=0.0),
        row(hold, 0.001, error_extension=2e-6),
        row(wrapped, 0.1),
        row(idiomatic, 10.0),
    ]
    batches = [compare.Batch("case", 10, 2, 0.4e-3, 5e-3, 1.5, True, 0.6e-3, True)]
    targets = {one.what.partition(": ")[2]: one for one in compare.targets(rows, batches)}
    verdicts = {what: (round(one.found, 12), one.met) for what, one in targets.items()}
    assert verdicts == {
        "other programs with RK4 (1), from kneexo's": (1e-12, True),
        "compiled RK4, time by C's": (2.0, False),
        "exact hold, times faster than C": (10.0, True),
        "exact hold, error of x": (2e-6, False),
        "wrapped, times faster than idiomatic": (100.0, True),
        "batch, ms a run and core": (0.4, False),
        "batch, ms with AVX2 code": (0.6, False),
        "runs of the batch equal those alone": (1.0, True),
        "AVX2 code gives the same bits": (1.0, True),
        "batch, scaling by cores": (0.75, False),
    }
    weight = compare.Batch("with weight", 10, 2, 0.8e-3, 20e-3, 1.9, False)
    targets = {one.what.partition(": ")[2]: one for one in compare.targets([], [weight])}
    assert targets["batch, ms a run and core"].met  # a 25th of C
    assert not targets["runs of the batch equal those alone"].met
    assert targets["batch, scaling by cores"].met
    assert str(targets["AVX2 code gives the same bits"]).endswith("not measured")
    missing = next(compare.targets([row(compare.C, 0.01)], []))
    assert math.isnan(missing.found)
    assert str(missing).endswith("not measured")


@pytest.mark.slow
def test_numba_agrees_with_the_compiled_model(load):
    pytest.importorskip("numba")
    hand_written, in_numba = load("hand_written"), load("hand_written_numba")
    for values in ({}, WEIGHT | LAW, PID):
        scenario = changed(Scenario(), values | QUANTIZED)
        p = hand_written.parameters_of(scenario)
        record = in_numba.run_numba(p, **options(scenario))
        assert relative_difference(record, in_kneexo(scenario)) < 1e-9


@pytest.mark.slow
def test_heyoka_agrees_with_the_exact_hold(load):
    pytest.importorskip("heyoka")
    scenario = changed(Scenario(), PID | FREE)
    p = load("hand_written").parameters_of(scenario)
    record = load("peers.with_heyoka").prepare(p, STEPS, SAMPLES * p.sample_time_s)()
    assert relative_difference(record, in_kneexo(scenario, "exact_hold")) < 1e-9


@pytest.mark.slow(gate=0)
def test_the_command_prints_every_row(tmp_path):
    file = tmp_path / "figures.json"
    run = subprocess.run(
        [sys.executable, BENCHMARKS / "compare.py", "--quick", "--json", file],
        env=os.environ | {"PYTHONPATH": str(BENCHMARKS.parent)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    data = json.loads(file.read_text(encoding="utf-8"))
    ours = [
        row
        for row in data["rows"]
        if row["way"].startswith(("kneexo compiled", "kneexo wrapped", "Drake"))
    ]
    assert len(ours) >= 30
    for row in data["rows"]:
        assert row["way"] in run.stdout
        measured = (row["time_s"] or 0.0) > 0.0
        excused = row["note"].startswith(("not installed", "no C compiler"))
        assert measured or (excused and row not in ours), row
        if row["rk4"] and measured:
            assert row["difference"] < 1e-9
    assert "MISSED" in run.stdout or "OK" in run.stdout
    assert len(data["batches"]) == 2


@pytest.mark.slow(gate=0)
def test_mutants_are_counted_and_tests_that_fail_anyway_say_nothing():
    pytest.importorskip("mutmut", reason="needs pip install '.[mutation]'")
    module = "kneexo/systems/encoder_count.py"
    command = [sys.executable, BENCHMARKS / "mutation.py", module]
    for test, code, text in (
        ("tests/systems/test_encoder_count.py", 0, "'killed'"),
        ("tests/systems/missing.py", 1, "pytest error"),
    ):
        run = subprocess.run([*command, test], capture_output=True, text=True)
        assert run.returncode == code
        assert text in run.stdout + run.stderr


@pytest.mark.slow(gate=0)
def test_the_rosenbrock_method_keeps_its_tolerance_on_stiff_presets(load, capsys):
    load("stiff").main(["--duration", "1", "--turns", "1"])
    _, *rows = (line.split(" | ") for line in capsys.readouterr().out.splitlines())
    errors = {(row[0], row[1]): float(row[4]) for row in rows}
    assert len(errors) == 16
    for preset in ("leg", "wearer"):
        assert errors[preset, "rosenbrock, 1e-07"] <= 1e-6
        assert errors[preset, "rosenbrock, 1e-07"] < errors[preset, "rosenbrock, 1e-05"]
        compiled = errors[preset, "compiled: rosenbrock, 1e-07"]
        assert compiled == pytest.approx(errors[preset, "rosenbrock, 1e-07"], rel=0.01)
