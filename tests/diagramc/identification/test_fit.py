"""Fits to logs of an independent program: a motor with lag and dead band moves a spring's mass."""

import re
from dataclasses import replace

import numpy as np
import pytest
from iminuit import Minuit
from pydrake.symbolic import Variable, max as larger, min as smaller, sin
from pydrake.systems.primitives import SymbolicVectorSystem
from scipy.integrate import solve_ivp

from diagramc import (
    InputTable,
    Log,
    ParameterError,
    Unknown,
    compile_diagram,
    identify,
    sensitivities,
)

T, HELD, ROWS = 0.01, 15, 495
X, V = "y0[0]", "y0[1]"
UNKNOWNS = (
    Unknown(".0[0]", 0.02, 0.2, unit="s"),  # lag
    Unknown(".0[1]", 2.0, 20.0),  # gain
    Unknown(".0[2]", 0.02, 0.4),  # dead band
    Unknown(".0[3]", 10.0, 100.0),  # stiffness
    Unknown(".0[4]", 0.3, 6.0),  # damping
    Unknown(f"{X}.delay_s", 0.0, 0.04, unit="s"),
    Unknown(f"{X}.bias", -0.3, 0.3),
    Unknown(f"{V}.gain", 0.5, 2.0),
)
TRUE = np.array([0.06, 8.0, 0.15, 40.0, 1.5, 0.012, 0.05, 1.1])
NOISE = np.array([0.01, 0.1])
COMMAND = np.repeat(np.random.default_rng(5).uniform(-1.0, 1.0, ROWS // HELD + 1), HELD)


@pytest.fixture(scope="module")
def model():
    v, x, w, u = (Variable(name) for name in "vxwu")
    p = lag, gain, dead, k, d = [Variable(name) for name in ("lag", "gain", "dead", "k", "d")]
    driven = larger(u - dead, 0.0) + smaller(u + dead, 0.0)
    rates = [(gain * driven - v) / lag, w, v - k * x - d * w]
    return compile_diagram(
        SymbolicVectorSystem(
            state=[v, x, w], input=[u], parameter=p, dynamics=rates, output=[x, v]
        ),
        inputs=["u0"],
    )


def machine(true, start=(0.0, 0.0, 0.0)):
    """The sensors of an own program at any times (n,): (n, 2)."""
    lag, gain, dead, k, d, delay, bias, factor = true
    y, solutions = np.array(start), []
    for i, u in enumerate(COMMAND[::HELD]):
        target = gain * np.sign(u) * max(abs(u) - dead, 0.0)
        matrix = np.array([[-1.0 / lag, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, -k, -d]])
        push = np.array([target / lag, 0.0, 0.0])
        span = (i * HELD * T, (i + 1) * HELD * T)
        run = solve_ivp(
            lambda t, y, a=matrix, b=push: a @ y + b,
            span,
            y,
            rtol=1e-9,
            atol=1e-11,
            dense_output=True,
        )
        solutions.append(run.sol)
        y = run.y[:, -1]

    def states(time_s):
        piece = np.clip(time_s / (HELD * T) + 1e-9, 0, len(solutions) - 1).astype(int)
        return np.array([solutions[i](t) for i, t in zip(piece, time_s, strict=True)])

    def sensors(time_s):
        x = states(np.maximum(time_s - delay, 0.0))[:, 1]
        return np.stack([x + bias, factor * states(time_s)[:, 0]], axis=1)

    return sensors


@pytest.fixture(scope="module")
def sensors():
    return machine(TRUE)


def log_of(sensors, seed=0, noise=0.0, colour=0.0, rows=ROWS, step=0.0):
    """A log with jitter of the stamps and noise that is an autoregression of first order."""
    random = np.random.default_rng(seed)
    time_s = np.maximum((np.arange(rows) + random.uniform(-0.2, 0.2, rows)) * T, 0.0)
    e = random.standard_normal((rows + 200, 2))
    for i in range(1, len(e)):
        e[i] = colour * e[i - 1] + np.sqrt(1.0 - colour**2) * e[i]
    y = sensors(time_s) + noise * NOISE * e[200:]
    if step:
        y[:, 0] = np.round(y[:, 0] / step) * step
    return Log(time_s, {X: y[:, 0], V: y[:, 1]}, T, {"u0": COMMAND[:rows]})


def z_of(values):
    return np.array([u.place(v) for u, v in zip(UNKNOWNS, values, strict=True)])


def test_a_log_without_noise_gives_back_each_number(model, sensors):
    fit = identify(model, log_of(sensors, rows=120), UNKNOWNS)
    np.testing.assert_allclose(list(fit.values.values()), TRUE, rtol=1e-4)
    assert min(*fit.train.values(), *fit.validation.values()) > 99.99
    assert set(fit.words.values()) == {"bounded"}


def test_a_sensor_shows_gain_times_the_delayed_output_plus_bias(model, sensors):
    log = log_of(sensors, rows=80)
    doubled = {X: 2.0 * (log.measured[X] - 0.05) + 0.05, V: log.measured[V]}
    log = Log(log.time_s, doubled, T, log.inputs)
    unknowns = [*UNKNOWNS[5:], Unknown(f"{X}.gain", 0.5, 4.0)]
    fit = identify(model, log, unknowns, parameters=TRUE[:5])
    np.testing.assert_allclose(list(fit.values.values()), [0.012, 0.05, 1.1, 2.0], rtol=1e-4)


@pytest.mark.parametrize("low", [0.5, -1.0])
def test_the_slope_is_the_derivative_of_the_value_by_its_place(low):
    unknown, place, h = Unknown("mass", low, 7.0), 0.3, 1e-5
    difference = (unknown.value(place + h) - unknown.value(place - h)) / (2.0 * h)
    assert unknown.slope(unknown.value(place)) == pytest.approx(difference, rel=1e-8)
    assert unknown.place(unknown.value(place)) == pytest.approx(place)


def test_sensitivities_are_derivatives_by_the_place_of_each_unknown_at_its_start(model, sensors):
    log = log_of(sensors, rows=60)
    unknowns = [replace(u, start=v) for u, v in zip(UNKNOWNS[5:], TRUE[5:], strict=True)]
    (found,) = sensitivities(model, log, unknowns, parameters=TRUE[:5])
    late = log.time_s >= 0.04  # the longest delay
    assert found.shape == (np.sum(late), 2, 3)
    np.testing.assert_allclose(found[:, 0, 1:], [[0.6, 0.0]] * len(found), atol=1e-9)
    np.testing.assert_allclose(found[:, 1, 1], 0.0)
    np.testing.assert_allclose(
        found[:, 1, 2], log.measured[V][late] * np.log(2.0 / 0.5), rtol=1e-4, atol=1e-4
    )
    with pytest.raises(ParameterError, match="output 'z': must be one of"):
        sensitivities(model, replace(log, measured={"z": log.time_s}), unknowns)


@pytest.mark.slow(gate=0)
def test_intervals_hold_what_they_promise_and_errors_are_those_of_cramer_and_rao(model, sensors):
    time_s = np.arange(ROWS) * T
    z, columns = z_of(TRUE), []
    for c in range(z.size):  # of the own program
        ends = []
        for step in (1e-3, -1e-3):
            moved = z.copy()
            moved[c] += step
            values = [u.value(p) for u, p in zip(UNKNOWNS, moved, strict=True)]
            ends.append(machine(values)(time_s) / NOISE)
        columns.append((ends[0] - ends[1]).ravel() / 2e-3)
    bound = np.sqrt(np.diag(np.linalg.inv(np.array(columns) @ np.array(columns).T)))
    for colour in (0.0, 0.8):
        inside, errors = [], []
        for seed in range(200):
            log = log_of(sensors, seed, 1.0, colour, step=0.002)
            fit = identify(model, log, UNKNOWNS, validation=0.0, threads=1)
            ends = np.array(list(fit.interval.values()))
            inside.append((ends[:, 0] <= TRUE) & (ends[:, 1] >= TRUE))
            errors.append(z_of(fit.values.values()) - z)
        share = np.mean(inside, axis=0)
        assert share.min() >= 0.9
        assert 0.935 <= share.mean() <= 0.965
        if not colour:
            assert np.max(np.sqrt(np.mean(np.square(errors), axis=0)) / bound) <= 1.2


@pytest.mark.slow(gate=0)
def test_profiles_are_those_of_minos(model, sensors):
    """MINOS of iminuit profiles a likelihood with an optimizer of its own (James and Roos 1975)."""
    places = [0, 2, 4]  # lag, dead band, damping
    asked = [UNKNOWNS[place] for place in places]
    log = log_of(sensors, noise=30.0, rows=200)
    fit = identify(model, log, asked, parameters=TRUE[:5], validation=0.0)
    measured = np.stack([log.measured[X], log.measured[V]], axis=1)

    def squares(values):
        parameters = TRUE[:5].copy()
        parameters[places] = values
        run = model.simulate(
            parameters,
            model.state(),
            log.time_s[-1],
            inputs=log.table({"u0": 1}),
            record_times_s=log.time_s,
        )
        return np.sum(((run["y0"] - measured) / [*fit.noise.values()]) ** 2)

    minuit = Minuit(squares, [*fit.values.values()])
    minuit.limits = [(unknown.low, unknown.high) for unknown in asked]
    minuit.migrad()
    minuit.minos(cl=0.95)
    lag = minuit.merrors[0]
    assert lag.upper > -1.1 * lag.lower  # an interval to first order would be wrong
    for unknown, best, error in zip(asked, minuit.values, minuit.merrors.values(), strict=True):
        assert fit.values[unknown.name] == pytest.approx(best, rel=0.01)
        np.testing.assert_allclose(
            fit.profile(unknown.name), [best + error.lower, best + error.upper], rtol=0.02
        )


def test_a_combination_is_named_with_its_partner(model, sensors):
    log = log_of(sensors, rows=100)
    alone = Log(log.time_s, {V: log.measured[V]}, T, log.inputs)
    unknowns = [UNKNOWNS[1], UNKNOWNS[7]]  # gain of motor and of sensor
    fit = identify(model, alone, unknowns, parameters=TRUE[:5])
    (note,) = (note for note in fit.notes if "hardly changes" in note)
    assert "up 10 %" in note
    assert "down 9.1 %" in note
    assert "fix " in note
    assert ".0[1]" in note
    assert f"{V}.gain" in note


def test_an_unknown_without_effect_is_refused_by_name(model, sensors):
    log = log_of(sensors, rows=60)
    alone = Log(log.time_s, {V: log.measured[V]}, T, log.inputs)
    with pytest.raises(ParameterError, match=r"\.0\[3\]: has no effect"):
        identify(model, alone, UNKNOWNS[:4], parameters=TRUE[:5])


def test_an_unknown_at_its_bound_has_a_one_sided_interval(model, sensors):
    short = Unknown(".0[0]", 0.08, 0.2, start=0.2)  # the true lag is 0.06 s
    log = log_of(sensors, noise=0.3, rows=100)
    fit = identify(model, log, [short], parameters=TRUE[:5])
    assert fit.words[".0[0]"] == "one-sided"
    assert fit.interval[".0[0]"][0] == pytest.approx(0.08)
    assert any("moved off its bound" in note for note in fit.notes)


def test_a_hole_makes_segments_with_states_of_their_own(model):
    start = (1.0, 0.1, 0.0)
    whole = log_of(machine(TRUE, start), rows=140)
    rows = np.r_[0:55, 85:140]
    log = Log(
        whole.time_s[rows],
        {name: values[rows] for name, values in whole.measured.items()},
        T,
        {"u0": COMMAND[rows]},
    )
    with pytest.raises(ParameterError, match="hole of more than ten"):
        identify(model, log, UNKNOWNS)
    states = [Unknown(name, -9.0, 9.0) for name in model.state_names]
    fit = identify(model, log, (*UNKNOWNS[5:], *states), parameters=TRUE[:5], validation=0.0)
    first = [fit.values[f"{name} (log 1, segment 1)"] for name in model.state_names]
    np.testing.assert_allclose(first, start, atol=1e-3)
    assert len(fit.values) == 9
    assert len(fit.residuals) == 2
    assert fit.values[f"{X}.delay_s"] == pytest.approx(0.012, rel=1e-3)


def test_a_loss_for_outliers_ignores_them(model, sensors):
    log = log_of(sensors, noise=0.1, rows=100)
    spoiled = {name: values.copy() for name, values in log.measured.items()}
    for values in spoiled.values():
        values[::20] += 5.0
    spoiled[X][3] = np.nan
    wrong = Log(log.time_s, spoiled, T, log.inputs)
    errors = []
    for loss in ("linear", "cauchy"):
        fit = identify(model, wrong, UNKNOWNS, loss=loss, validation=0.0)
        errors.append(np.abs(z_of(fit.values.values()) - z_of(TRUE)).max())
    np.testing.assert_allclose(list(fit.noise.values()), 0.1 * NOISE, rtol=0.5)
    assert errors[1] < 0.2 * errors[0]


def test_a_held_out_log_an_input_table_and_a_profile(model, sensors):
    log = log_of(sensors, noise=1.0, rows=100)
    table = InputTable(np.arange(1, 100) * T, COMMAND[:100, None, None])
    same = Log(log.time_s, log.measured, T, table)
    options = {"parameters": TRUE[:5], "held_out": [log_of(sensors, 1, 1.0, rows=60)]}
    fits = [identify(model, which, UNKNOWNS[5:], **options) for which in (log, same)]
    assert fits[0].values == fits[1].values
    assert fits[0].validation.keys() == {X, V}
    np.testing.assert_allclose(fits[0].profile(f"{V}.gain"), fits[0].interval[f"{V}.gain"], 0.01)
    assert "± (95 %)" in str(fits[0])


def test_a_second_minimum_as_good_is_told(model, sensors):
    """The output sees the square of the unknown."""
    a, x = Variable("a"), Variable("x")
    squared = compile_diagram(
        SymbolicVectorSystem(state=[x], parameter=[a], dynamics=[a * a - x], output=[x])
    )
    time_s = np.arange(60) * T
    y = 4.0 * (1.0 - np.exp(-time_s)) + 1e-3 * np.random.default_rng(0).standard_normal(60)
    fit = identify(squared, Log(time_s, {"y0": y}, T), [Unknown(".0[0]", -5.0, 5.0, 1.0)], starts=6)
    assert abs(fit.values[".0[0]"]) == pytest.approx(2.0, rel=1e-2)
    assert fit.words[".0[0]"] == "several minima"


def waved(amplitude, k, start, seed):
    """A fit to an output that rises and falls with the unknown, whose true value is 2."""
    a, x = Variable("a"), Variable("x")
    rate = a + amplitude * sin(k * a) - x
    model = compile_diagram(
        SymbolicVectorSystem(state=[x], parameter=[a], dynamics=[rate], output=[x])
    )
    time_s, random = np.arange(300) * T, np.random.default_rng(seed)
    y = (2.0 + amplitude * np.sin(2.0 * k)) * (1.0 - np.exp(-time_s))
    log = Log(time_s, {"y0": y + 0.05 * random.normal(size=300)}, T)
    return identify(model, log, [Unknown(".0[0]", 1.0, 4.0, start)])


def test_an_interval_is_wider_where_the_misfit_has_kinks():
    fit = waved(0.02, 100.0, 2.0, 1)
    (note,) = (note for note in fit.notes if "kinks" in note)
    wider = float(re.search(r"guess, (\S+) times as wide", note)[1])
    slope = 1.0 + 2.0 * np.cos(100.0 * fit.values[".0[0]"])  # too steep at the result
    deviation = 0.05 / np.linalg.norm(slope * (1.0 - np.exp(-np.arange(225) * T)))
    assert wider > 1.5
    assert np.ptp(fit.interval[".0[0]"]) == pytest.approx(3.92 * wider * deviation, rel=0.25)


def test_a_search_goes_on_from_a_lower_place_nearby():
    assert waved(0.005, 300.0, 1.9, 2).values[".0[0]"] == pytest.approx(2.0, abs=0.01)


def test_a_note_tells_how_far_from_white_the_residuals_are(model, sensors):
    notes, widths = [], []
    for colour in (0.0, 0.8, -0.8):
        log = log_of(sensors, 3, 1.0, colour)
        fit = identify(model, log, UNKNOWNS[5:], parameters=TRUE[:5], validation=0.0)
        notes.append([note for note in fit.notes if note.startswith(f"{V}: the residuals")])
        widths.append(np.ptp(fit.interval[f"{V}.gain"]))
    white, (coloured,), (swinging,) = notes
    assert not white
    numbers = r"autocorrelation (.*) at lag 1, ±0.089 if white.* time (.*) s, .* 490 values as (.*)"
    first, time_s, alone = map(float, re.search(numbers, coloured).groups())
    assert first == pytest.approx(0.8, abs=0.06)
    assert time_s == pytest.approx(9.0 * T, rel=0.4)  # (1 + 0.8)/(1 - 0.8) rows
    assert alone == pytest.approx(490 * T / time_s, rel=0.1)
    assert swinging.endswith("opposite signs, so the intervals are those of white noise")
    assert widths[2] == pytest.approx(widths[0], rel=0.1)  # a third, if the sum narrowed them


def test_a_note_tells_of_residuals_that_follow_an_input(model, sensors):
    log = log_of(sensors, 3, 1.0, rows=200)
    told = [
        [
            note
            for note in identify(model, log, asked, parameters=TRUE[:5]).notes
            if "follow" in note
        ]
        for asked in (UNKNOWNS[5:], UNKNOWNS[5:7])  # without the gain of the sensor
    ]
    assert not told[0]
    assert told[1][0].startswith(f"{V}: the residuals follow u0: ")
    assert told[1][0].endswith("returns coloured noise into u0")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_s": [0.0, 0.2, 0.1]}, "time goes back or stands at row 2, 0.1 s"),
        ({"measured": {X: [1.0, 2.0]}}, r"has the shape \(2,\) for 3 times"),
        ({"measured": {X: [np.nan] * 3}}, "is nan from row 0"),
        ({"sample_time_s": 0.0}, "sample_time_s = 0 s: must be finite and > 0"),
    ],
)
def test_a_wrong_log_is_refused(change, message):
    given = {"time_s": [0.0, 0.1, 0.2], "measured": {X: [1.0] * 3}, "sample_time_s": 0.1}
    with pytest.raises(ParameterError, match=message):
        Log(**(given | change))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"unknowns": [Unknown("mass", 1.0, 2.0)]}, "unknown 'mass': must be one of"),
        ({"unknowns": UNKNOWNS[:1] * 2}, "is listed twice"),
        ({"loss": "square"}, "a loss of linear"),
        ({"measured": {"z": np.ones(60)}}, "output 'z': must be one of"),
        ({"rows": 15}, "rows from 0 s; must have 20"),
        ({"inputs": {}}, "inputs must be those of the model: u0"),
    ],
)
def test_a_wrong_argument_is_refused(model, sensors, changes, message):
    log = log_of(sensors, rows=changes.pop("rows", 60))
    given = {"measured": log.measured, "inputs": log.inputs}
    given |= {name: changes.pop(name) for name in ("measured", "inputs") if name in changes}
    arguments = {"unknowns": UNKNOWNS} | changes
    with pytest.raises(ParameterError, match=message):
        identify(model, Log(log.time_s, given["measured"], T, given["inputs"]), **arguments)


@pytest.mark.parametrize("numbers", [(2.0, 1.0, None), (1.0, np.inf, None), (1.0, 2.0, 3.0)])
def test_a_wrong_range_is_refused(numbers):
    with pytest.raises(ParameterError, match="mass: "):
        Unknown("mass", *numbers)
