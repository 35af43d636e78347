from dataclasses import replace

import numpy as np
import pytest

from diagramc import Reduction
from kneexo.analysis import simulate
from kneexo.errors import (
    KneexoError,
    LinkageError,
    ParameterError,
    SimulationError,
    StiffnessError,
    UnstableStepError,
)
from kneexo.parameters import Scenario, SimulationParameters
from kneexo.parameters.paths import changed
from kneexo.parameters.presets import with_preset
from kneexo.simulation import compiled, engines
from kneexo.simulation.engines import RunRequest, can_reduce, reduce_run, serve_runs

SHORT = Scenario(simulation=SimulationParameters(duration_s=0.2))


def refuse_the_exact_hold(monkeypatch):
    original = compiled.simulate_together

    def refusing(scenarios, signals, integrator, *options, **named):
        if integrator == "exact_hold":
            return [StiffnessError("the derivatives jump too often")]
        return original(scenarios, signals, integrator, *options, **named)

    monkeypatch.setattr(compiled, "simulate_together", refusing)


def test_small_steps_stand_in_where_the_exact_hold_gives_up(monkeypatch):
    expected = simulate(SHORT, signals=("rod_extension",))
    refuse_the_exact_hold(monkeypatch)
    run = simulate(SHORT, signals=("rod_extension",))
    assert (run.settings.integrator, run.settings.step_s) == ("rk4", 2e-5)
    assert expected.settings.integrator == "exact_hold"
    # Both are far more accurate than that; the rod moves by 1 mm.
    np.testing.assert_allclose(run["rod_extension_m"], expected["rod_extension_m"], atol=1e-10)


def test_another_failure_is_not_repeated(monkeypatch):
    calls = []

    def failing(scenarios, *options, **named):
        calls.append(options)
        return [SimulationError("left the stroke")]

    monkeypatch.setattr(compiled, "simulate_together", failing)
    with pytest.raises(SimulationError, match="left the stroke"):
        simulate(SHORT)
    assert len(calls) == 1


@pytest.mark.parametrize("integrator", ["rk4", "radau3"])
def test_a_run_of_too_many_steps_is_refused(integrator):
    settings = SimulationParameters(duration_s=1e3, step_s=1e-7, integrator=integrator)
    with pytest.raises(ParameterError, match=r"duration_s = 1000 s .* 1e\+10 steps, must be at"):
        simulate(Scenario(simulation=settings), signals=("knee_angle",))


def test_the_exact_hold_chooses_its_own_steps():
    settings = SimulationParameters(duration_s=101.0, step_s=1e-7)
    assert settings.duration_s / settings.step_s > engines.MOST_STEPS
    assert simulate(Scenario(simulation=settings), signals=("knee_angle",)).time_s[-1] == 101.0


def test_a_run_that_would_not_fit_into_memory_is_refused_by_its_size(monkeypatch):
    # 0.2 s/2 ms = 100 samples of 8 bytes.
    monkeypatch.setattr(engines, "LARGEST_RUN_BYTES", 799)
    with pytest.raises(ParameterError, match=r"100 samples of 1 columns take 7\.45e-07 GiB"):
        simulate(SHORT, signals=("knee_angle",))
    monkeypatch.setattr(engines, "LARGEST_RUN_BYTES", 800)
    assert simulate(SHORT, signals=("knee_angle",)).time_s[-1] == pytest.approx(0.2)


@pytest.mark.parametrize("integrator", ["exact_hold", "radau3"])
def test_progress_ends_at_the_duration(integrator):
    times_s = []
    settings = SimulationParameters(duration_s=0.1, integrator=integrator)
    simulate(Scenario(simulation=settings), signals=("knee_angle",), progress=times_s.append)
    assert times_s[-1] == pytest.approx(0.1)


# ----------------------------------------------------------------------------- many together


def varied(count):
    """Runs of two structures and three durations, one of which fails."""
    laws = ({"kind": "smc"}, {"kind": "pid"})
    return [
        changed(
            SHORT,
            {
                "controller": laws[n % 2],
                "plant.cylinder.mass_kg": 1.4 + 0.05 * n,
                "simulation.duration_s": (0.1, 0.2, 0.05)[n % 3],
                "initial_offset_m": -0.15 if n == 4 else 0.0,
            },
        )
        for n in range(count)
    ]


def together(scenarios, **options):
    requests = {10 * n: RunRequest(scenario, **options) for n, scenario in enumerate(scenarios)}
    runs = dict(serve_runs(requests))
    assert set(runs) == set(requests)
    return [runs[10 * n] for n in range(len(scenarios))]


def assert_same(actual, expected):
    if isinstance(expected, Exception):
        assert (type(actual), str(actual)) == (type(expected), str(expected))
        return
    assert actual.settings == expected.settings
    assert list(actual.data) == list(expected.data)
    np.testing.assert_array_equal(actual.time_s, expected.time_s)
    for name, values in expected.data.items():
        np.testing.assert_array_equal(actual[name], values)


def alone(scenario, **options):
    try:
        return simulate(scenario, **options)
    except KneexoError as error:
        return error


@pytest.mark.parametrize("largest", [64, 3, 1])
def test_runs_do_not_depend_on_their_company(monkeypatch, largest):
    monkeypatch.setattr(engines, "LARGEST_BATCH", largest)
    scenarios = varied(9)
    scenarios[2] = scenarios[2].with_steps(4e-4)
    scenarios[5] = scenarios[5].with_engine("drake")
    expected = [alone(scenario, signals=("knee_angle", "load_pressure")) for scenario in scenarios]
    assert isinstance(expected[4], ParameterError)
    integrators = [run.settings.integrator for run in (expected[1], expected[2], expected[5])]
    assert integrators == ["exact_hold", "rk4", "radau3"]
    for order in (1, -1):
        runs = together(scenarios[::order], signals=("knee_angle", "load_pressure"))
        for run, run_alone in zip(runs[::order], expected, strict=True):
            assert_same(run, run_alone)


def test_a_structure_is_one_batch_and_a_batch_is_bounded(monkeypatch):
    sizes = []
    original = compiled.simulate_together

    def counted(scenarios, *options, **named):
        durations = [scenario.simulation.duration_s for scenario in scenarios]
        assert durations == sorted(durations, reverse=True)  # what ends together runs together
        sizes.append(len(scenarios))
        return original(scenarios, *options, **named)

    monkeypatch.setattr(compiled, "simulate_together", counted)
    together(varied(9), signals=("knee_angle",))
    assert sizes == [5, 4]
    monkeypatch.setattr(engines, "_LARGEST_RECORD", 210)  # two runs of 0.2 s
    sizes.clear()
    together(varied(9), signals=("knee_angle",))
    assert sizes == [2, 3, 2, 2]  # the shorter the more


def test_small_steps_stand_in_for_single_runs_of_a_batch(monkeypatch):
    original = compiled.simulate_together
    scenarios = varied(4)
    expected = [simulate(s, signals=("knee_angle",)) for s in scenarios]

    def refusing(scenarios, signals, integrator, *options, **named):
        runs = original(scenarios, signals, integrator, *options, **named)
        heavy = [scenario.plant.cylinder.mass_kg > 1.52 for scenario in scenarios]
        stiff = integrator == "exact_hold"
        return [
            StiffnessError("jumps") if stiff and refused else run
            for run, refused in zip(runs, heavy, strict=True)
        ]

    monkeypatch.setattr(compiled, "simulate_together", refusing)
    runs = together(scenarios, signals=("knee_angle",))
    assert [run.settings.integrator for run in runs] == ["exact_hold"] * 3 + ["rk4"]
    for run, run_alone in zip(runs[:3], expected[:3], strict=True):
        assert_same(run, run_alone)
    assert_same(runs[3], simulate(scenarios[3].with_steps(2e-5), signals=("knee_angle",)))


def test_small_steps_that_are_too_long_are_repeated_with_those_of_the_error(monkeypatch):
    original, steps = compiled.simulate_together, []

    def refusing(scenarios, signals, integrator, *options, **named):
        if integrator == "exact_hold":
            return [StiffnessError("jumps") for _ in scenarios]
        steps.append((len(scenarios), options[0]))
        runs = original(scenarios, signals, integrator, *options, **named)
        error = UnstableStepError("too long")
        error.step_s = {2e-5: 1e-5, 1e-5: 8e-6}.get(options[0], 0.0)
        heavy = [scenario.plant.cylinder.mass_kg > 1.52 for scenario in scenarios]
        return [
            error if refused and error.step_s else run
            for run, refused in zip(runs, heavy, strict=True)
        ]

    monkeypatch.setattr(compiled, "simulate_together", refusing)
    runs = together(varied(4), signals=("knee_angle",))
    assert steps == [(2, 2e-5), (2, 2e-5), (1, 1e-5), (1, 8e-6)]
    assert [run.settings.step_s for run in runs] == [2e-5, 2e-5, 2e-5, 8e-6]


@pytest.mark.parametrize("stuck", [False, True])
def test_rosenbrock_stands_in_where_rk4_needs_too_many_steps(monkeypatch, stuck):
    original, ways = compiled.simulate_together, []

    def refusing(scenarios, signals, integrator, *options, **named):
        ways.append((integrator, options[0]))
        if integrator == "rk4":
            error = UnstableStepError("t = 0 s: rk4 cannot follow x[2], a mode; set step_s = 1")
            error.step_s = {2e-5: 1.01e-6}.get(options[0], 0.99e-6)  # 2 ms / 2000 is 1 µs
            return [error]
        if integrator == "exact_hold" or stuck:
            return [StiffnessError("too stiff")]
        return original(scenarios, signals, integrator, *options, **named)

    monkeypatch.setattr(compiled, "simulate_together", refusing)
    heavy = SHORT.changed({"plant.cylinder.mass_kg": 9.0})
    if stuck:
        with pytest.raises(
            StiffnessError, match=r"follow x\[2\], a mode, .*=9\.0.*2020 steps a sam"
        ):
            simulate(heavy, signals=("knee_angle",))
    else:
        run = simulate(heavy, signals=("knee_angle",))
        assert run.settings.integrator == "rosenbrock"
    assert ways[1:] == [("rk4", 2e-5), ("rk4", 1.01e-6), ("rosenbrock", 2e-3)]


def test_a_user_who_chose_rosenbrock_gets_its_error(monkeypatch):
    def stuck(scenarios, *options, **named):
        return [StiffnessError("1000 substeps") for _ in scenarios]

    monkeypatch.setattr(compiled, "simulate_together", stuck)
    with pytest.raises(StiffnessError, match="1000 substeps"):
        simulate(SHORT.changed({"simulation.integrator": "rosenbrock"}), signals=("knee_angle",))


def test_large_valves_do_not_take_steps_of_nanoseconds():
    """RK4 would need 16 ns, and takes 44 s of processor time for a second."""
    values = {
        "plant.full_order.makeup_conductance_m3_per_s_pa": 1e-6,
        "simulation.duration_s": 0.05,
    }
    run = simulate(Scenario.preset("wearer").changed(values), signals=("knee_angle",))
    assert run.settings.integrator == "rosenbrock"
    values |= {"simulation.integrator": "rosenbrock", "simulation.tolerance": 1e-10}
    right = simulate(Scenario.preset("wearer").changed(values), signals=("knee_angle",))
    np.testing.assert_allclose(run["knee_angle_rad"], right["knee_angle_rad"], rtol=0, atol=1e-6)


def test_drakes_third_order_names_a_step_that_is_too_long():
    """Its default step is that of the other integrators, and the oil moves at 447 Hz."""
    scenario = SHORT.changed({"simulation.integrator": "runge_kutta3"})
    with pytest.raises(
        UnstableStepError, match=r"with steps of 0\.002 s .* set step_s = "
    ) as caught:
        simulate(scenario, signals=("knee_angle",))
    stable = scenario.changed({"simulation.step_s": caught.value.step_s})
    assert np.isfinite(simulate(stable, signals=("knee_angle",))["knee_angle_rad"]).all()


@pytest.mark.slow
def test_steps_of_the_user_that_are_too_long_end_the_run():
    """On the way, RK4 at 0.1 ms ended preset ``leg`` at 0.2085 rad, where 0.1747 rad is right."""
    leg = Scenario.model_validate(with_preset("leg", {})).changed({"simulation.duration_s": 0.1})
    with pytest.raises(
        UnstableStepError, match=r"rk4 with steps of 0\.0002 s cannot follow plant/c"
    ) as caught:
        simulate(leg.with_steps(2e-4))
    assert 0.0 <= caught.value.time_s < 0.1
    expected = simulate(leg, signals=("knee_angle",))
    run = simulate(leg.with_steps(caught.value.step_s), signals=("knee_angle",))
    np.testing.assert_allclose(run["knee_angle_rad"], expected["knee_angle_rad"], rtol=0, atol=1e-6)


def test_a_bad_scenario_does_not_spoil_those_of_its_structure(monkeypatch):
    for name in ("_models", "_diagrams"):
        monkeypatch.setattr(compiled, name, compiled.Recent())
    broken = SHORT.plant.linkage.model_copy(update={"a_2_m": 1.0})
    unknown = changed(SHORT, {"plant.linkage": broken})
    runs = together([unknown, SHORT], signals=("knee_angle",))
    assert isinstance(runs[0], LinkageError)
    assert_same(runs[1], simulate(SHORT, signals=("knee_angle",)))
    with pytest.raises(ParameterError, match="signal 'no' is unknown"):
        simulate(SHORT, signals=("no",))


@pytest.mark.parametrize("controller", ["smc", pytest.param("pid", marks=pytest.mark.slow)])
def test_all_engines_send_a_drive_the_same_integers(controller):
    values = {"controller": {"kind": controller}, "bus": {"kind": "cia402"}}
    scenario = changed(Scenario(), values | {"simulation.duration_s": 0.05})
    steps = {"exact_hold": 0.002, "rk4": 1e-4, "runge_kutta3": 1e-4}
    runs = {}
    for integrator, step_s in steps.items():
        settings = {"simulation.integrator": integrator, "simulation.step_s": step_s}
        runs[integrator] = simulate(changed(scenario, settings), signals=("target_velocity",))
    integers = {name: run["target_velocity_units"] for name, run in runs.items()}
    assert np.unique(integers["exact_hold"]).size > 5
    np.testing.assert_array_equal(integers["rk4"], integers["exact_hold"])
    np.testing.assert_array_equal(integers["runge_kutta3"], integers["exact_hold"])


REDUCTIONS = (
    Reduction("maximum", "motor_speed_command", magnitude=True, after_s=0.1),
    Reduction("count", "knee_angle", bound=0.3),
)


def test_reductions_do_not_depend_on_the_company_and_have_numbers_of_their_own():
    scenarios = varied(9)
    reductions = [
        tuple(replace(r, after_s=0.004 * n, bound=0.3 + 0.01 * n) for r in REDUCTIONS)
        for n in range(9)
    ]
    requests = {
        n: RunRequest(scenario, (), reductions=reductions[n])
        for n, scenario in enumerate(scenarios)
    }
    requests |= {9: RunRequest(scenarios[0], ("knee_angle",))}  # a log in the same round
    runs = dict(serve_runs(requests))
    assert runs[9].reduced.size == 0
    signals = ("motor_speed_command", "knee_angle")
    assert str(runs.pop(4)).startswith("the rod starts at")
    for n, scenario in enumerate(scenarios):
        if n == 4:
            continue
        logged = simulate(scenario, signals=signals)
        command = logged["motor_speed_command_rad_s"][logged.time_s >= 0.004 * n - 1e-9]
        expected = [
            np.abs(command).max(initial=0.0),
            np.sum(logged["knee_angle_rad"][logged.time_s >= 0.004 * n - 1e-9] >= 0.3 + 0.01 * n),
        ]
        assert runs[n].reduced.tolist() == reduce_run(scenario, reductions[n]).tolist() == expected
        assert runs[n].data == {}


def test_reductions_are_repeated_with_small_steps(monkeypatch):
    expected = reduce_run(SHORT, REDUCTIONS)
    refuse_the_exact_hold(monkeypatch)
    np.testing.assert_allclose(reduce_run(SHORT, REDUCTIONS), expected, rtol=1e-6)


def test_only_compiled_runs_reduce():
    assert can_reduce(SHORT)
    assert not can_reduce(SHORT.with_engine("drake"))
