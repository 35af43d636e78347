"""Web models: the modules of a page run as the compiled engine does, wherever a slider stands."""

import base64
import json
import math
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import PPoly
from web_cases import solver_of

from kneexo.errors import KneexoError
from kneexo.geometry import linkage
from kneexo.page.maps import map_value
from kneexo.page.model import (
    START,
    START_RATE,
    controller_of,
    web_model,
    web_modules,
    with_structure,
)
from kneexo.page.modules import SHIPPED
from kneexo.parameters import HINGE, PlantParameters, Scenario, gait_reference
from kneexo.parameters.paths import changed
from kneexo.simulation.compiled import simulate_together

CURVES = ("knee_angle_rad", "motor_speed_command_rad_s", "load_pressure_pa")
SIGNALS = ("knee_reference", "knee_angle", "motor_speed_command", "load_pressure")
WORN_CURVES = ("interaction_torque_n_m", "wearer_angle_rad", "wearer_rate_rad_s")
KEYS = ("breaks", "powers")
BENCH = Scenario.model_validate(SHIPPED["bench"])
LEG = Scenario.model_validate(SHIPPED["leg"])


@cache
def model_of(scenario):
    """The model of a scenario; the tests share it, for it takes a second.

    It has no quantities of a push, which the page's worker adds: tests/page/web/test_worker.py.
    """
    model = web_model(scenario)
    parts = [q for q in model["quantities"] if not q["name"].startswith("push.")]
    return model | {"quantities": parts}


def parameters_of(part, values):
    """The parameters of a module, as a page computes them."""
    row = np.array(part["base"])
    for formula in part["maps"]:
        row[formula["index"]] = map_value(formula, values)
    return row


def spline_of(source):
    """A piecewise polynomial of the data of a model."""
    breaks, powers = (np.frombuffer(base64.b64decode(source[key])) for key in KEYS)
    return PPoly(powers.reshape(breaks.size + 1, -1)[1:-1].T[::-1], breaks)


HERMITE = np.array(
    [
        np.polynomial.Polynomial.basis(n).deriv(order)(at)
        for at in (0.0, 1.0)
        for order in range(4)
        for n in range(8)
    ]
).reshape(8, 8)
"""Value and three derivatives of the powers 0…7 at 0 and at 1."""


def interval_rows(reference, spline, period):
    """The input of `IntervalReference` at each sample, from the reference at the samples (n, 4).

    A spline gives its own polynomials; else one of degree 7 has the values at both ends.
    """
    rows = np.zeros((len(reference) - 1, 14))
    rows[:, 0], rows[:, 1] = period * np.arange(len(rows)), 1e9
    for row, ends in zip(rows, pairwise(reference), strict=True):
        start = row[0]
        if spline is None:
            base = np.array([ends[0][0], 0.0, 0.0, 0.0])  # without it, rates lose digits
            scaled = np.concatenate([(end - base) * period ** np.arange(4) for end in ends])
            row[2:10] = np.linalg.solve(HERMITE, scaled)
            row[2] = base[0]
            continue
        scale = period ** np.arange(4) / np.array([1.0, 1.0, 2.0, 6.0])
        (inside,) = np.nonzero((spline.x > start + 1e-12) & (spline.x < start + period))
        segment = min(np.searchsorted(spline.x, start + 1e-12) - 1, spline.c.shape[1] - 1)

        def powers(number, at):
            piece = np.polynomial.Polynomial(spline.c[::-1, number])
            return [piece.deriv(n)(at) for n in range(4)]

        row[2:6] = scale * powers(segment, start - spline.x[segment])
        if inside.size:
            row[1] = spline.x[inside[0]]
            row[10:] = scale * powers(inside[0], start - spline.x[inside[0]])
    return rows


def values_of(model, kind):
    """The present values of all numbers that a user varies."""
    quantities = [*model["quantities"], *model["references"][kind].get("quantities", ())]
    return {quantity["name"]: quantity["value"] for quantity in quantities}


@pytest.fixture
def run_on_page(web_run):
    """``run(model, kind, values, ticks)``: the columns of a run, as a page makes it."""
    loaded = {}

    def module(modules, key):
        if key not in loaded:
            loaded[key] = web_run(base64.b64decode(modules[key]["code"]))
        return loaded[key], modules[key]["table"]

    def run(model, kind, values, ticks):
        modules, source = web_modules([model]), model["references"][kind]
        if kind == "samples":
            spline = spline_of(source)
            time = 0.002 * np.arange(ticks + 1)  # within the breaks
            reference = np.column_stack([spline(time, order) for order in range(4)])
        else:
            instance, table = module(modules, source["module"])
            reference = instance.run(table, ticks=ticks, params=parameters_of(source, values))
        instance, table = module(modules, model["loop"]["module"])
        start = {START: reference[0, 0], START_RATE: reference[0, 1]}
        params = parameters_of(model["loop"], values | start)
        inputs = [reference[:-1]]
        if model["wearer"]:
            spline = spline_of(source) if kind == "samples" else None
            inputs = [interval_rows(reference, spline, 0.002)]
        if model["moment"]:
            inputs.append(spline_of(model["moment"])(0.002 * np.arange(ticks)))
        inputs = np.column_stack([*inputs, np.zeros(ticks)])
        outputs = instance.run(table, inputs, params=params)
        columns = dict(zip(table["outputs"], outputs.T, strict=True))
        return columns | {"knee_reference_rad": reference[:, 0]}

    return run


def require_same_curves(run_on_page, scenario, model, changes, duration_s):
    """The curves of a page are those of the engine by the same method, to 1e-9 of their largest.

    The greatest difference that was measured is 1e-11, by another order of operations.
    """
    kind, period = scenario.reference.kind, scenario.controller.sample_time_s
    changed = scenario.changed({**changes, "simulation.duration_s": duration_s})
    table = web_modules([model])[model["loop"]["module"]]["table"]
    worn = scenario.wearer.kind != "none"
    signals = SIGNALS + ("interaction_torque", "wearer_motion") * worn
    (run,) = simulate_together([changed], signals, **solver_of(table))
    assert not isinstance(run, KneexoError), f"{changes}: {run}"
    values = values_of(model, kind) | changes
    columns = run_on_page(model, kind, values, round(duration_s / period))
    for name in ("knee_reference_rad", *CURVES, *WORN_CURVES * worn):
        largest = np.abs(run[name]).max()
        np.testing.assert_allclose(
            columns[name], run[name], rtol=0, atol=1e-9 * largest, err_msg=f"{name} with {changes}"
        )


def ends(model, kind):
    """Changes of one number to an end of its slider, for each end."""
    for quantity in [*model["quantities"], *model["references"][kind]["quantities"]]:
        for end in ("low", "high"):
            yield {quantity["name"]: quantity[end]}


def fits_the_motion(changes):
    sine = {"reference.mean_deg": 40.0, "reference.amplitude_deg": 30.0} | changes
    mean, amplitude = sine["reference.mean_deg"], sine["reference.amplitude_deg"]
    return 0.0 <= mean - amplitude < mean + amplitude <= 90.0


@pytest.mark.slow
def test_a_page_runs_the_loop_of_the_engine(run_on_page):
    model = model_of(Scenario())
    require_same_curves(run_on_page, Scenario(), model, {}, 0.4)
    changes = {
        "plant.pump.gear_ratio": 3.0,
        "plant.pump.speed_limit_rad_s": 200.0,
        "controller.lambda_per_s": 12.0,
        "reference.mean_deg": 30.0,
        "reference.frequency_hz": 0.7,
        "encoder.mounting_error_rad": 0.004,
    }
    require_same_curves(run_on_page, Scenario(), model, changes, 0.4)


@pytest.mark.slow
def test_a_page_has_the_inertia_of_the_load_in_place_of_the_mass(run_on_page):
    pytest.importorskip("ziglang")
    path = "plant.load.inertia_kg_m2"
    scenario = Scenario().changed({"plant.load": {"kind": "knee", "inertia_kg_m2": 0.064}})
    model = model_of(scenario)
    names = {quantity["name"] for quantity in model["quantities"]}
    assert path in names
    assert "plant.cylinder.mass_kg" not in names
    for inertia in (0.03, 0.2):
        require_same_curves(run_on_page, scenario, model, {path: inertia}, 0.4)


STRUCTURES = [
    with_structure(scenario, controller, load)
    for scenario, loads in ((Scenario(), ("none", "knee")), (BENCH, ("knee",)), (LEG, ("knee",)))
    for load in loads
    for controller in ("smc", "pid")
]
STRUCTURES.append(changed(LEG, {"plant.linkage": HINGE}))


def name_of(scenario):
    order = "reduced" if scenario.plant.full_order is None else "full"
    bus = scenario.bus.kind
    load, link = scenario.plant.load.kind, scenario.plant.linkage
    return f"{controller_of(scenario)}, load {load}, {order} order, bus {bus}, {link}"


@pytest.mark.slow
@pytest.mark.parametrize("scenario", STRUCTURES, ids=name_of)
def test_every_slider_gives_the_curves_of_the_engine(scenario, run_on_page):
    model = model_of(scenario)
    assert len(model["quantities"]) >= 18
    for changes in ends(model, "sine"):
        if fits_the_motion(changes):
            require_same_curves(run_on_page, scenario, model, changes, 3.0)
    random = np.random.default_rng(5)
    for _ in range(10):
        share = random.uniform(0.35, 0.65, len(model["quantities"]))  # loops that are stable
        changes = {
            q["name"]: q["value"] + 0.2 * (part - 0.5) * (q["high"] - q["low"])
            for part, q in zip(share, model["quantities"], strict=True)
        }
        changes = {
            q["name"]: min(max(changes[q["name"]], q["low"]), q["high"])
            for q in model["quantities"]
        }
        require_same_curves(run_on_page, scenario, model, changes, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["step", "ramp"])
def test_every_reference_gives_the_curves_of_the_engine(kind, run_on_page):
    scenario = Scenario().changed({"reference.kind": kind})
    model = model_of(scenario)
    for changes in ends(model, kind):
        require_same_curves(run_on_page, scenario, model, changes, 3.0)


@pytest.mark.slow
def test_a_sampled_reference_is_its_spline(run_on_page):
    gait = gait_reference(0.2, 1)
    scenario = Scenario(reference=gait, simulation={"duration_s": 5.0})
    model = model_of(scenario)
    samples = model["references"]["samples"]
    assert set(samples) == {"breaks", "powers"}
    require_same_curves(run_on_page, scenario, model, {}, 1.0)


@pytest.mark.slow
def test_the_start_follows_reference_load_and_lever(run_on_page):
    # An oracle by the definition of rest: no acceleration, so P_L Ā = F_L + K x.
    scenario = with_structure(Scenario(), "smc", "knee")
    model = model_of(scenario)
    values = values_of(model, "sine") | {
        "plant.load.segment_mass_kg": 3.3,
        "plant.load.centre_of_mass_m": 0.31,
        "plant.load.knee_torque_n_m": 4.0,
        "plant.cylinder.stiffness_n_per_m": 700.0,
        "reference.amplitude_deg": 11.0,
    }
    columns = run_on_page(model, "sine", values, 1)
    area = math.pi / 4.0 * (0.020**2 - 0.5 * 0.010**2)
    first = {name: column[0] for name, column in columns.items()}
    assert first["knee_angle_rad"] == pytest.approx(math.radians(29.0), abs=1e-12)
    table = web_modules([model])[model["loop"]["module"]]["table"]
    extension = first["rod_extension_m"]
    angle = first["knee_angle_rad"]
    arm = float(linkage.moment_arm(scenario.plant.linkage, angle))
    force = (3.3 * 9.81 * 0.31 * math.sin(-angle) + 4.0) / arm + 700.0 * extension
    assert first["load_pressure_pa"] * area == pytest.approx(force, rel=1e-10)
    assert table["sample_time_s"] == 0.002


@pytest.mark.slow
def test_a_model_is_json_and_says_what_a_number_is():
    model = json.loads(json.dumps(model_of(LEG), allow_nan=False))
    gear = model["quantities"][0]
    assert gear["name"] == "plant.pump.gear_ratio"
    assert (gear["value"], gear["unit"], gear["scale"]) == (6.0, "1", "log")
    assert gear["low"] < 6.0 < gear["high"]
    assert "Section 5: 6:1" in gear["source"]
    for quantity in model["quantities"]:
        assert quantity["low"] <= quantity["value"] <= quantity["high"]
    assert (model["controller"], model["load"]) == ("smc", "knee")


@pytest.mark.slow
def test_the_limits_follow_the_sliders():
    limits = model_of(LEG)["limits"]
    rpm = 2.0 * math.pi / 60.0
    speed = {"plant.pump.speed_limit_rad_s": 2000.7 * rpm}
    # The bus of the leg rounds to whole revolutions per minute.
    command = map_value(limits["command_limit_rad_s"], speed)
    assert command == pytest.approx(2000.0 * rpm, rel=1e-14)
    assert map_value(limits["motor_speed_limit_rad_s"], speed) == pytest.approx(2000 * rpm)
    assert limits["pressure_rating_pa"] == 3.5e6
    assert limits["power_rating_w"] == 200.0
    assert limits["knee_high_rad"] == math.radians(90.0)
    relief = {"plant.full_order.relief_pressure_pa": 2.2e6}
    assert map_value(limits["relief_pressure_pa"], relief) == 2.2e6


def test_the_limits_of_the_reduced_order():
    limits = model_of(Scenario())["limits"]
    assert limits["relief_pressure_pa"] is None
    assert map_value(limits["command_limit_rad_s"], {"plant.pump.speed_limit_rad_s": 100.0}) == 100
    # The counts over the range of motion add up to the range of θ_4.
    count = limits["encoder_count_knee_deg"]
    assert (count["low_deg"], count["high_deg"], len(count["values"])) == (0.0, 90.0, 91)
    counts = np.trapezoid(1.0 / np.array(count["values"]), np.linspace(0.0, 90.0, 91))
    first, last = linkage.encoder_angle(Scenario().plant.linkage, np.radians([0.0, 90.0]))
    assert counts == pytest.approx(abs(last - first) / (2.0 * math.pi / 4096.0), rel=1e-3)


def test_the_other_structure_has_its_defaults_and_the_rest_stays():
    scenario = Scenario().changed({"plant.pump.gear_ratio": 4.0, "controller.lambda_per_s": 9.0})
    other = with_structure(scenario, "pid", "knee")
    assert (other.controller.kind, other.plant.load.kind) == ("pid", "knee")
    assert other.plant.pump.gear_ratio == 4.0
    assert with_structure(scenario, "smc", "none") == scenario
    back = with_structure(other, "smc", "none")
    assert back == scenario.changed({"controller.lambda_per_s": 20.0})


def test_the_loop_without_quantizers_adds_no_half_count():
    model = model_of(Scenario())
    modules = web_modules([model])
    offsets = {}
    for name in ("loop", "smooth"):
        place = modules[model[name]["module"]]["table"]["params"].index("coordinates.offset_rad")
        offsets[name] = model[name]["base"][place]
        (formula,) = (m for m in model[name]["maps"] if m["index"] == place)
        turned = map_value(formula, {"encoder.mounting_error_rad": 0.01})
        assert turned == pytest.approx(offsets[name] - 0.01, abs=1e-15)
    assert offsets == {"loop": pytest.approx(math.pi / 4096.0), "smooth": 0.0}


@pytest.mark.slow
def test_a_controller_of_another_plant_keeps_its_limit():
    limits = web_model(Scenario(nominal=PlantParameters()))["limits"]
    slow = {"plant.pump.speed_limit_rad_s": 100.0}
    assert limits["command_limit_rad_s"] == pytest.approx(5000.0 * math.pi / 30.0)
    assert map_value(limits["motor_speed_limit_rad_s"], slow) == 100.0


# --------------------------------------------------------------------------------- wearer

WEARER = {"plant": {"load": "knee"}, "wearer": "leg", "controller": "torque"}
WALK = gait_reference(0.5)


def worn(**fields):
    """A scenario of reduced order with a wearer."""
    return Scenario.model_validate(WEARER | {"simulation": {"duration_s": 1.0}} | fields)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scenario",
    [
        worn(),
        worn(controller={"kind": "torque", "mode": "impedance"}, reference=WALK),
        worn(wearer={"kind": "leg", "motion": "active"}, reference=WALK),
        worn(wearer={"kind": "leg", "motion": "passive", "cuff": {"slip_torque_n_m": 5.0}}),
        worn(
            controller={"kind": "torque", "mode": "assist"},
            wearer={
                "kind": "leg",
                "moment": {"times_s": [0.0, 0.1234, 1.0], "moments_n_m": [0.0, 30.0, -20.0]},
            },
        ),
    ],
)
def test_a_leg_of_a_wearer_moves_on_a_page_as_in_the_engine(scenario, run_on_page):
    model = model_of(scenario)
    changes = {"wearer.cuff.stiffness_n_m_per_rad": 900.0}
    if scenario.reference.kind == "sine":
        changes |= {"reference.frequency_hz": 2.0, "reference.ramp_s": 0.3}
    require_same_curves(run_on_page, scenario, model, changes, 0.8)


def amplifies(scenario, model, changes):
    """Whether a relative change of 1e-12 of the cuff changes a curve by more than 2e-11.

    Where valves that open and close amplify nothing, the change is at most 1e-11. Ends that amplify
    are low gains, much leak, no feedforward, no friction and a slow motor.
    """
    table = web_modules([model])[model["loop"]["module"]]["table"]
    first = scenario.changed(changes | {"simulation.duration_s": 2.0})
    stiffness = first.wearer.cuff.stiffness_n_m_per_rad * (1.0 + 1e-12)
    second = first.changed({"wearer.cuff.stiffness_n_m_per_rad": stiffness})
    signals = (*SIGNALS, "interaction_torque", "wearer_motion")
    run, other = simulate_together([first, second], signals, **solver_of(table))
    return any(
        np.abs(run[name] - other[name]).max() > 2e-11 * np.abs(run[name]).max()
        for name in (*CURVES, *WORN_CURVES)
    )


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["impedance", "zero_torque"])
def test_every_slider_of_a_wearer_gives_the_curves_of_the_engine(mode, run_on_page):
    """Leave out the cases in which opening and closing valves amplify rounding errors."""
    scenario = with_structure(Scenario.preset("wearer"), mode, "knee")
    model, compared = model_of(scenario), 0
    for changes in ends(model, "sine"):
        if fits_the_motion(changes) and not amplifies(scenario, model, changes):
            require_same_curves(run_on_page, scenario, model, changes, 2.0)
            compared += 1
    assert compared > 1.5 * len(model["quantities"])
