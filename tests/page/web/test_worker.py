"""Runs, margins and sweeps of the worker, compared with the compiled engine and its analyses."""

import math

import numpy as np
import pytest
from web_cases import solver_of

from kneexo.analysis import interaction_metrics
from kneexo.analysis.frequency.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.frequency.sine_estimate import SineEstimateSettings, estimate_sine
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.tracking.tracking import track
from kneexo.errors import KneexoError, LinearizationError
from kneexo.page.model import web_model, web_modules, with_structure
from kneexo.parameters import Scenario, gait_reference
from kneexo.parameters.criteria import RECOVERY_BAND_DEG
from kneexo.parameters.presets import with_preset
from kneexo.systems.knee_reference import run_middle_deg

QUICK = {"reference.frequency_hz": 1.0, "reference.amplitude_deg": 5.0}
"""A sine of 1 Hz, which a short run repeats."""

SCENARIOS = {
    f"{name} {controller}": Scenario(**(values | {"controller": {"kind": controller}}))
    for name, values in {
        "paper": {},
        "load": {"plant": {"load": {"kind": "knee"}}},
        "bench": with_preset("bench", {}),
        "leg": with_preset("leg", {}),
    }.items()
    for controller in ("smc", "pid")
}
STRUCTURES = SCENARIOS | {
    "hinge": SCENARIOS["leg smc"].changed(
        {"plant.linkage": "hinge", "plant.knee.overshoot_deg": 1.0}
    ),
    "inertia in place of the mass": SCENARIOS["load smc"].changed(
        {"plant.load.inertia_kg_m2": 0.064}
    ),
    "step": Scenario(reference="step"),
    "ramp": Scenario(reference="ramp"),
}

MARGINS = (
    *("gain_margin", "gain_margin_frequency_hz", "lower_gain_margin"),
    *("phase_margin_deg", "phase_margin_frequency_hz"),
    *("delay_margin_s", "delay_margin_frequency_hz"),
)


def loaded(worker, scenario, name="model"):
    """Load the model of a scenario into the worker and return it."""
    model = web_model(scenario)
    worker.ask(kind="load", modules=web_modules([model]), models={name: model})
    return model


def in_kneexo(scenario, model, duration_s):
    """The run of the compiled engine with the method of a module."""
    table = web_modules([model])[model["loop"]["module"]]["table"]
    settings = {"duration_s": duration_s} | solver_of(table)
    return track(scenario.changed({f"simulation.{k}": v for k, v in settings.items()}))


def check_metrics(metrics, result):
    """Rounding can move a crossing of a limit by a sample, and a share by one sample's."""
    expected = result.metrics
    sample_s = result.scenario.controller.sample_time_s
    share = 1.0 / result.run.time_s.size
    pairs = {"largest_error_rad": math.radians(expected.max_error_deg)}
    pairs["saturated_share"] = expected.saturated_share
    pairs["peak_pressure_pa"] = 1e6 * expected.peak_pressure_mpa
    pairs["error_bound_rad"] = math.radians(result.verdict.error_bound_deg)
    for name, value in pairs.items():
        least = 1.01 * share if name.endswith("_share") else 1e-12
        assert metrics[name] == pytest.approx(value, rel=1e-6, abs=least), name
    late_s = metrics["max_error_time_s"] - result.verdict.max_error_time_s
    assert abs(late_s) < 1.01 * sample_s
    assert metrics["tracks"] == result.verdict.tracks
    cycle, expected = metrics["limit_cycle"], result.verdict.limit_cycle
    assert (cycle is None) == (expected is None)
    if expected is not None:
        assert math.degrees(cycle["amplitude_rad"]) == pytest.approx(expected.amplitude_deg)
        assert cycle["highest_pressure_pa"] == pytest.approx(1e6 * expected.highest_pressure_mpa)
        for name in ("start_s", "period_s"):
            assert cycle[name] == pytest.approx(getattr(expected, name), abs=1.01 * sample_s)


def check_run(answer, result):
    """Compare curves and metrics.

    Rounding can decide whether a substep of the Rosenbrock method is good. A relative change of
    1e-15 of the mass moves a sample of a pushed leg by 1.3e-8 of the largest pressure. So the
    curves may differ by a tenth of the method's tolerance of 1e-6.
    """
    stiff = result.run.settings.integrator == "rosenbrock"
    share = 1e-7 if stiff else 1e-8
    for name, column in {
        "angle": "knee_angle_rad",
        "reference": "knee_reference_rad",
        "command": "motor_speed_command_rad_s",
        "pressure": "load_pressure_pa",
    }.items():
        expected = result[column]
        size = np.max(np.abs(expected))
        np.testing.assert_allclose(answer["columns"][name], expected, rtol=0.0, atol=share * size)
    np.testing.assert_array_equal(answer["time"], result.run.time_s)
    check_metrics(answer["metrics"], result)


def dense_grid(loop):
    """Frequencies in Hz, dense also around a resonance without damping."""
    poles = np.linalg.eigvals(loop.loop.a)
    poles = poles[poles.imag > 0.0]
    centres = np.angle(poles) / loop.sample_time_s / math.tau
    widths = (1.0 - np.abs(poles)) / loop.sample_time_s / math.tau
    near = centres + np.linspace(-10.0, 10.0, 2001)[:, None] * widths
    grid = np.append(loop.frequency_grid(), near)
    return grid[(grid > 0.02) & (grid < 0.5 / loop.sample_time_s)]


def check_margins(answer, scenario):
    """Compare margins; return whether the loop is stable."""
    try:
        loop = linearize_loop(scenario, knee_angle_deg=run_middle_deg(scenario))
    except LinearizationError:
        assert answer["stable"] is None
        assert answer["failure"]
        return False
    assert answer["largest_eigenvalue"] == pytest.approx(abs(loop.eigenvalues[0]), abs=1e-5)
    assert answer["stable"] == loop.stable
    if loop.stable:
        expected = loop.margins()
        for name in MARGINS:
            value = getattr(expected, name)
            smallest = 1e-4 if name == "lower_gain_margin" else 0.0  # a pole at zero frequency
            assert answer[name] == pytest.approx(value, rel=1e-3, abs=smallest, nan_ok=True), name
        peak = np.max(np.abs(loop.sensitivity(dense_grid(loop))))
        # The distance 1/peak of L from −1 has an absolute error too.
        assert 1.0 / answer["sensitivity_peak"] == pytest.approx(1.0 / peak, rel=1e-3, abs=2e-6)
        for name, value in (
            ("feedback_bandwidth_hz", loop.complementary_sensitivity_bandwidth_hz()),
            ("bandwidth_linear_hz", loop.bandwidth_hz()),
        ):
            assert answer[name] == (None if math.isnan(value) else pytest.approx(value, rel=1e-3))
    return loop.stable


def test_a_wrong_request_has_an_answer_in_words(worker):
    assert worker.ask(kind="march")["error"] == "kind march is unknown"
    assert worker.ask(kind="run", model="none")["error"] == "model none is not loaded"


def changes_of(model, kind):
    """Values of one number at an end of its slider; then of all numbers, a little away at once."""
    numbers = [q for q in model["quantities"] if not q["name"].startswith("push.")]  # tested below
    for quantity in numbers + model["references"][kind]["quantities"]:
        yield from ({quantity["name"]: quantity[end]} for end in ("low", "high"))
    lows, highs, values = (np.array([q[n] for q in numbers]) for n in ("low", "high", "value"))
    for shares in np.random.default_rng(5).uniform(-0.03, 0.03, (5, len(numbers))):
        moved = np.clip(values + shares * (highs - lows), lows, highs)
        yield dict(zip((q["name"] for q in numbers), moved.tolist(), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", STRUCTURES)
def test_each_quantity_has_the_effect_of_its_parameter(worker, name):
    """Curves and metrics of stable loops; at both ends of each slider also margins."""
    if name.startswith("inertia"):  # the package has the modules of all others
        pytest.importorskip("ziglang", reason="needs Zig: pip install ziglang")
    kind = STRUCTURES[name].reference.kind
    quick = QUICK if kind == "sine" else {}
    scenario = STRUCTURES[name].changed(quick | {"simulation.duration_s": 2.5})
    model, stable = loaded(worker, scenario), 0
    for changes in changes_of(model, kind):
        values = quick | changes
        try:
            changed = scenario.changed(values)
        except KneexoError:  # such as a sine that leaves the range of motion
            continue
        request = {"model": "model", "reference": kind, "values": values, "duration_s": 2.5}
        margins = worker.ask(kind="linear", **request)
        answer = worker.ask(kind="run", **request)
        assert answer.get("error") is margins.get("error") is None, (changes, answer, margins)
        try:
            is_stable = margins["stable"] if len(changes) > 1 else check_margins(margins, changed)
            if not is_stable:
                continue
            stable += 1
            result = in_kneexo(changed, model, 2.5)
            assert answer["end"] is None
            check_run(answer, result)
        except AssertionError as error:
            raise AssertionError(f"{changes}: {error}") from error
    assert stable > len(model["quantities"]) > 10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper smc", "paper pid", "leg smc"])
def test_minus_3_db_and_its_points_are_those_of_kneexo(worker, name):
    scenario = SCENARIOS[name].changed({"reference.amplitude_deg": 20.0})
    loaded(worker, scenario)
    values = {"reference.amplitude_deg": 20.0}
    request = {"kind": "sweep", "model": "model", "values": values}
    answer = worker.ask(frequencies=[0.2, 1.37], **request)
    settings = SineEstimateSettings(averaged_cycles=2, largest_cycles=6)
    assert [point["frequency_hz"] for point in answer["points"][:2]] == [0.2, 1.37]
    for point in answer["points"][:2]:
        at = scenario.changed({"reference.frequency_hz": point["frequency_hz"]})
        estimate = estimate_sine(at, settings)
        gain = complex(*(point["gain"] * f(math.radians(point["phase_deg"])) for f in TURN))
        assert abs(gain - estimate.response) < 1e-3 * abs(estimate.response)
        for share in ("speed_limited_share", "acceleration_limited_share"):
            assert point[share] == pytest.approx(getattr(estimate, share), abs=2e-3)
        assert point["saturated_share"] >= point["speed_limited_share"]
    expected = large_signal_bandwidth_hz(scenario)
    # Both searches end when the gain is 1/√2 to 0.05 %.
    assert answer["minus_3_db_hz"] == pytest.approx(expected, rel=1.5e-3)
    alone = worker.ask(frequencies=[], near_hz=expected, **request)
    assert alone["minus_3_db_hz"] == pytest.approx(expected, rel=1.5e-3)
    assert len(alone["points"]) <= 8


TURN = (math.cos, math.sin)


@pytest.mark.slow
def test_a_newer_request_cancels_the_older_one_of_its_set_up(worker):
    loaded(worker, Scenario())
    request = {"kind": "run", "model": "model", "reference": "sine", "values": {}}
    numbers = [
        worker.send(setup=setup, duration_s=duration_s, **request)
        for setup, duration_s in ((0, 100.0), (1, 1.0), (0, 2.0))
    ]
    answers = {}
    while len(answers) < len(numbers):
        answer = worker.receive()
        if "unfinished" not in answer:
            answers[answer["id"]] = answer
    assert answers[numbers[0]] == {"id": numbers[0], "cancelled": True}
    assert answers[numbers[1]]["time"][-1] == 1.0
    assert answers[numbers[2]]["time"][-1] == 2.0


@pytest.mark.slow
def test_a_request_can_be_cancelled(worker):
    loaded(worker, Scenario())
    sweep = {"kind": "sweep", "model": "model", "values": {}, "frequencies": [0.05, 0.05]}
    other, number = worker.send(setup=1, **sweep), worker.send(setup=0, **sweep)
    worker.send(kind="cancel", setup=0, kinds=["linear", "sweep"])
    ends = {}
    while len(ends) < 2:
        answer = worker.receive()
        if answer["id"] in (number, other) and "point" not in answer:
            ends[answer["id"]] = answer
    assert ends[number] == {"id": number, "cancelled": True}
    assert ends[other]["minus_3_db_hz"] > 0.1


@pytest.mark.slow
def test_the_part_in_view_comes_first_and_is_the_begin_of_the_run(worker):
    """The parts of a long run, which differ from the run in nothing but their ends."""
    scenario = SCENARIOS["leg smc"]
    loaded(worker, scenario)
    request = {"kind": "run", "model": "model", "reference": "sine", "duration_s": 60.0}
    whole = worker.ask(values={}, **request)
    # Of another set-up, because the same one would go on from the end of its last run.
    late = worker.ask(values={}, view_s=[20.0, 22.0], setup=1, **request)
    assert late["columns"] == whole["columns"]
    assert late["parts"][0]["time"][-1] > 20.0
    for answer in (late, whole):
        assert answer["parts"]
        for part in answer["parts"]:
            rows = len(part["time"])
            assert rows < len(answer["time"])
            for name, column in part["columns"].items():
                assert column == whole["columns"][name][:rows], name
            assert part["end"] is None
        assert not answer.get("unfinished")
    short = worker.ask(kind="run", model="model", reference="sine", values={}, duration_s=0.1)
    assert short["parts"] == []


@pytest.mark.slow
def test_a_run_between_the_points_of_a_sweep_changes_neither(worker):
    loaded(worker, Scenario())
    sweep = {"kind": "sweep", "model": "model", "values": {}, "frequencies": [0.5]}
    run = {"kind": "run", "model": "model", "reference": "sine", "values": {}, "duration_s": 3.0}
    alone = worker.ask(**sweep), worker.ask(**run)
    numbers = worker.send(**sweep), worker.send(**run)
    answers, points = {}, []
    while len(answers) < 2:
        answer = worker.receive()
        if "point" in answer:
            points.append(answer["point"])
        else:
            answers[answer["id"]] = answer
    assert next(iter(answers)) == numbers[1]  # the run does not wait for the sweep
    assert points == alone[0]["points"]
    assert answers[numbers[1]]["columns"] == alone[1]["columns"]


@pytest.mark.slow
def test_a_step_has_the_metrics_of_a_step(worker):
    reference = {"kind": "step", "start_deg": 30.0, "end_deg": 33.0, "time_s": 0.5}
    scenario = Scenario(reference=reference)
    model = loaded(worker, scenario)
    answer = worker.ask(kind="run", model="model", reference="step", values={}, duration_s=2.0)
    result = in_kneexo(scenario, model, 2.0)
    check_run(answer, result)
    step, metrics = result.step, answer["metrics"]
    assert metrics["rise_time_s"] == pytest.approx(step.rise_time_s)
    assert metrics["settling_time_s"] == pytest.approx(step.settling_time_s)
    assert metrics["overshoot_percent"] == pytest.approx(step.overshoot_percent, rel=1e-6)
    final = math.degrees(metrics["final_error_rad"])
    assert final == pytest.approx(step.final_error_deg, abs=1e-8)
    short = worker.ask(kind="run", model="model", reference="step", values={}, duration_s=0.51)
    assert short["metrics"]["rise_time_s"] is short["metrics"]["settling_time_s"] is None
    assert not short["metrics"]["tracks"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reference", "cycles"),
    [
        ({"kind": "step"}, True),
        ({"kind": "step", "time_s": 9.0}, True),  # not reached, so the knee holds 30°
        ({"kind": "ramp", "time_s": 6.5}, False),  # run in part
        ({"kind": "sine", "frequency_hz": 0.3, "ramp_s": 9.0}, False),
        ({"kind": "sine", "amplitude_deg": 0.0, "frequency_hz": 0.5}, True),
    ],
)
def test_a_page_judges_what_is_run(worker, reference, cycles):
    scenario = Scenario.preset("bench").changed({"reference": reference})
    model = loaded(worker, scenario)
    request = {"model": "model", "reference": reference["kind"], "values": {}, "duration_s": 8.0}
    result = in_kneexo(scenario, model, 8.0)
    answer = worker.ask(kind="run", **request)
    check_run(answer, result)
    assert (answer["metrics"]["limit_cycle"] is not None) == cycles
    margins = worker.ask(kind="linear", **request)
    middle = run_middle_deg(result.scenario)
    assert margins["knee_angle_deg"] == pytest.approx(middle, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["cubic", "linear"])
def test_samples_are_a_reference_and_end_with_a_constant_angle(worker, interpolation):
    times, angles = (0.1, 0.5, 1.0, 1.5), (30.0, 40.0, 35.0, 45.0)
    samples = {"kind": "samples", "times_s": times, "angles_deg": angles}
    scenario = Scenario(
        reference=samples | {"interpolation": interpolation}, simulation={"duration_s": 1.0}
    )
    model = loaded(worker, scenario)
    request = {"kind": "run", "model": "model", "reference": "samples", "values": {}}
    for duration_s in (0.8, 1.5, 2.0):  # a part, all, and beyond the last sample
        answer = worker.ask(duration_s=duration_s, **request)
        check_run(answer, in_kneexo(scenario, model, duration_s))
    longer = answer
    assert longer["columns"]["reference"][-1] == pytest.approx(math.radians(45.0))
    assert longer["columns"]["angle"][-1] == pytest.approx(math.radians(45.0), abs=1e-3)
    for duration_s, middle in ((0.5, 35.0), (1.0, 35.0), (1.5, 37.5)):
        margins = worker.ask(**(request | {"kind": "linear", "duration_s": duration_s}))
        assert margins["knee_angle_deg"] == pytest.approx(middle, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("duration_s", [2.0, 10.1, 19.996, 19.998])
def test_a_run_of_less_than_two_periods_has_the_error_of_the_whole_run(worker, duration_s):
    """The P controller lags by 4°, so the rest of a run after its first period hides the error."""
    scenario = Scenario(controller={"kind": "pid"})
    model = loaded(worker, scenario)
    request = {"kind": "run", "model": "model", "reference": "sine", "values": {}}
    metrics = worker.ask(duration_s=duration_s, **request)["metrics"]
    check_metrics(metrics, in_kneexo(scenario, model, duration_s))
    assert metrics["tracks"] is False
    assert (metrics["max_error_time_s"] > 10.0) == (duration_s == 19.998)


@pytest.mark.slow
def test_a_run_that_fails_ends_with_time_and_reason(worker):
    scenario = Scenario(reference={"amplitude_deg": 1.0, "mean_deg": 88.9, "frequency_hz": 1.0})
    pid = {"kind": "pid", "proportional_per_s": 1e3}
    loaded(worker, scenario.changed({"controller": pid}))
    request = {"model": "model", "reference": "sine", "values": {}}
    answer = worker.ask(kind="run", duration_s=20.0, **request)
    assert 0.0 < answer["end"]["time_s"] < 20.0
    assert "range of motion" in answer["end"]["reason"]
    assert answer["time"][-1] == pytest.approx(answer["end"]["time_s"])
    for column in answer["columns"].values():
        assert len(column) == len(answer["time"])
        assert np.isfinite(column).all()
    margins = worker.ask(kind="linear", duration_s=20.0, **request)
    assert margins["stable"] is False
    assert margins["largest_eigenvalue"] > 1.0
    sweep = worker.ask(kind="sweep", frequencies=[1.0], **request)
    assert sweep["minus_3_db_hz"] is None
    assert "range of motion" in sweep["failure"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["load smc", "leg pid"])
def test_a_push_on_a_page_is_that_of_kneexo(worker, name):
    """Curves and metrics, and a sweep and margins that do not feel the push."""
    scenario = SCENARIOS[name]
    model = loaded(worker, scenario)
    push = {"torque_n_m": 90.0, "start_s": 2.0011, "duration_s": 0.15}
    values = QUICK | {f"push.{quantity}": value for quantity, value in push.items()}
    request = {"kind": "run", "model": "model", "reference": "sine", "duration_s": 6.0}
    answer = worker.ask(values=values, band_deg=RECOVERY_BAND_DEG, **request)
    result = in_kneexo(scenario.changed(QUICK | {"push": push}), model, 6.0)
    check_run(answer, result)
    metrics = answer["metrics"]["push"]
    largest = math.radians(result.push.largest_deviation_deg)
    assert metrics["largest_deviation_rad"] == pytest.approx(largest, rel=1e-6)
    sample_s = 1.01 * scenario.controller.sample_time_s  # rounding can move a crossing
    assert metrics["recovery_time_s"] == pytest.approx(result.push.recovery_time_s, abs=sample_s)
    assert 0.1 < metrics["recovery_time_s"] < 4.0
    assert answer["parts"][-1]["columns"] == answer["columns"]  # before the run without the push
    again = worker.ask(values=values, band_deg=RECOVERY_BAND_DEG, **request)
    assert again["metrics"] == answer["metrics"]
    assert again["columns"] == answer["columns"]  # goes on from a moment before the push
    assert all(len(part["time"]) < len(again["time"]) for part in again["parts"])  # it is known
    size = "Simulator.instanceOf(Simulator.modelOf({ model: 'model' }).loop.module, 'run 0')"
    assert worker.evaluate(f"{size}.kept.moments[0].memory.length") < 1e5  # quick to copy
    quiet = worker.ask(values=values | {"push.torque_n_m": 0.0}, **request)
    assert "push" not in quiet["metrics"]
    free = {name: quiet["columns"][name] for name in answer["free"]}
    assert answer["free"] == free
    for setup, start_s in enumerate((4.5, 0.0, 2.5, 5.9), 1):  # the last one in the last piece
        pushed = values | {"push.start_s": start_s, "push.duration_s": 0.1}
        uncut = worker.ask(values=pushed, setup=setup, **request)
        cut = worker.ask(values=pushed, **request)
        assert cut["columns"] == uncut["columns"]
        assert (cut["metrics"], cut["free"]) == (uncut["metrics"], free)
    largest = np.max(np.abs(np.subtract(answer["columns"]["angle"], quiet["columns"]["angle"])))
    assert metrics["largest_deviation_rad"] == largest  # as if the push had not been
    points = [
        worker.ask(kind="sweep", model="model", values=given, frequencies=[2.0])["points"][0]
        for given in (QUICK, values)
    ]
    assert points[0] == points[1]


WORN = {"plant": {"load": "knee"}, "wearer": "leg", "controller": "torque"}
SINE = {"kind": "sine", "frequency_hz": 0.8, "amplitude_deg": 15.0, "mean_deg": 30.0}
IMPEDANCE = {"controller": {"kind": "torque", "mode": "impedance"}}
MOMENT = {"times_s": [0.0, 0.1234, 4.0], "moments_n_m": [0.0, 30.0, -20.0]}
WEARERS = {
    "zero torque": (SINE, {}),
    "impedance": (SINE, IMPEDANCE),
    "impedance, walking": (gait_reference(1.2), IMPEDANCE),
    "active": (gait_reference(1.2), {"wearer": {"kind": "leg", "motion": "active"}}),
    "slipping": (
        SINE,
        {
            "wearer": {"kind": "leg", "motion": "passive", "cuff": {"slip_torque_n_m": 2.0}},
            **IMPEDANCE,
        },
    ),
    "assisted": (
        SINE,
        {
            "controller": {"kind": "torque", "mode": "assist"},
            "wearer": {"kind": "leg", "moment": MOMENT},
        },
    ),
}
"""Reference, and what differs from `WORN`."""


@pytest.mark.slow
@pytest.mark.parametrize("name", WEARERS)
def test_a_wearer_feels_on_a_page_the_torque_of_kneexo(worker, name):
    """Curves to 1e-9 of their largest, and the metrics of the interaction."""
    reference, fields = WEARERS[name]
    short = {"reference": reference, "simulation": {"duration_s": 4.0}}
    scenario = Scenario.model_validate(WORN | short | fields)
    kind = scenario.reference.kind
    model = loaded(worker, scenario)
    cuff = {"stiffness_n_m_per_rad": 900.0, "damping_n_m_s_per_rad": 8.0}
    values = {f"wearer.cuff.{name}": value for name, value in cuff.items()}
    answer = worker.ask(kind="run", model="model", reference=kind, values=values, duration_s=4.0)
    result = in_kneexo(scenario.changed(values), model, 4.0)
    check_run(answer, result)
    for name, column in {
        "torque": "interaction_torque_n_m",
        "wearer": "wearer_angle_rad",
        "angle": "knee_angle_rad",
    }.items():
        size = np.max(np.abs(result[column]))
        np.testing.assert_allclose(
            answer["columns"][name], result[column], rtol=0.0, atol=1e-9 * size
        )
    period_s = 1.25 if kind == "sine" else 0.0
    expected = interaction_metrics(result.run, period_s=period_s)
    assert expected.start_s == period_s
    for name in INTERACTION:
        assert answer["metrics"][name] == pytest.approx(getattr(expected, name), rel=1e-6), name


INTERACTION = ("rms_torque_n_m", "peak_torque_n_m", "power_from_wearer_w", "power_to_wearer_w")


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["impedance", "zero_torque"])
def test_each_quantity_of_a_wearer_has_the_effect_of_its_parameter(worker, mode):
    """For 0.3 s, in which valves that open and close amplify rounding little."""
    scenario = with_structure(Scenario.preset("wearer"), mode, "knee")
    model, compared = loaded(worker, scenario), 0
    request = {"kind": "run", "model": "model", "reference": "sine", "duration_s": 0.3}
    for changes in changes_of(model, "sine"):
        try:
            changed = scenario.changed(changes)
        except KneexoError:  # such as a sine that leaves the range of motion
            continue
        answer, result = worker.ask(values=changes, **request), in_kneexo(changed, model, 0.3)
        expected = result["interaction_torque_n_m"]
        np.testing.assert_allclose(
            answer["columns"]["torque"],
            expected,
            rtol=0.0,
            atol=1e-7 * np.max(np.abs(expected)),
            err_msg=str(changes),
        )
        check_run(answer, result)
        compared += 1
    assert compared > 1.5 * len(model["quantities"])
