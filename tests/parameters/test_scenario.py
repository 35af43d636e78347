"""A scenario is hashable, can be sent to a worker, and knows the plant of its controller."""

import pickle

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    G2,
    CylinderParameters,
    KneeLoadParameters,
    PidParameters,
    PlantParameters,
    SampledReference,
    Scenario,
    SimulationParameters,
    gait_reference,
)
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import dump_scenario, load_scenario
from kneexo.studies.paper import IDEAL_SMC


def test_the_controller_believes_in_the_plant_unless_a_nominal_one_is_given() -> None:
    nominal = PlantParameters(cylinder=CylinderParameters(mass_kg=1.0))
    assert Scenario().believed_plant is Scenario().plant
    assert Scenario(nominal=nominal).believed_plant == nominal


@pytest.mark.parametrize(
    "scenario",
    [
        Scenario(),
        IDEAL_SMC,
        Scenario(
            nominal=PlantParameters(linkage=G2, load=KneeLoadParameters()),
            controller=PidParameters(),
            reference=SampledReference(times_s=(0.0, 1.0, 2.0), angles_deg=(5.0, 6.0, 5.5)),
        ),
    ],
    ids=["default", "ideal", "pid"],
)
def test_scenario_is_hashable_and_picklable(scenario: Scenario) -> None:
    copy = pickle.loads(pickle.dumps(scenario))
    assert copy == scenario
    assert hash(copy) == hash(scenario)
    assert len({scenario, copy, Scenario(bus={"latency_samples": 3})}) == 2


TEN_SECONDS = SampledReference(times_s=(-1.0, 0.0, 4.0, 10.0), angles_deg=(20, 20, 40, 30))


@pytest.mark.parametrize(
    ("reference", "duration_s"),
    [
        ({"kind": "sine", "frequency_hz": 2.0}, 30.0),
        ({"kind": "step"}, 30.0),
        (TEN_SECONDS, 10.0),
        ({"kind": "gait", "frequency_hz": 0.8, "cycles": 3}, 3.75),
    ],
    ids=["sine", "step", "samples", "gait"],
)
def test_a_run_ends_with_the_samples_of_its_reference(reference, duration_s) -> None:
    scenario = Scenario(reference=reference)
    assert scenario.duration_s == pytest.approx(duration_s, rel=1e-15)
    assert scenario.with_duration().simulation.duration_s == scenario.duration_s
    longer = changed(scenario, {"simulation.duration_s": 12.0})
    assert longer.duration_s == 12.0
    assert longer.with_duration() == longer


def test_rounding_limits_the_tolerance_of_the_rosenbrock_method():
    settings = {"simulation.integrator": "rosenbrock"}
    assert changed(Scenario(), settings | {"simulation.tolerance": 1e-12}).simulation.compiled
    assert changed(Scenario(), {"simulation.tolerance": 1e-13}).simulation.tolerance == 1e-13
    with pytest.raises(ParameterError, match=r"tolerance = 1e-13 must be at least 1e-12 for rosen"):
        changed(Scenario(), settings | {"simulation.tolerance": 1e-13})


def test_a_change_keeps_the_duration_open(tmp_path) -> None:
    scenario = Scenario(simulation=SimulationParameters(integrator="rk4"))
    copy = changed(scenario, {"reference": TEN_SECONDS, "simulation.step_s": 1e-3})
    assert copy.duration_s == 10.0
    for case in (copy, copy.with_duration()):
        path = tmp_path / "case.yaml"
        path.write_text(dump_scenario(case), encoding="utf-8")
        assert load_scenario(path) == case


def test_reference_and_moment_of_walking_have_one_frequency():
    """A dumped scenario has tables, whose frequency is known too; a moment of a file has none."""
    walking = {
        **Scenario.preset("wearer").model_dump(exclude={"reference", "wearer"}),
        "reference": {"kind": "gait", "frequency_hz": 0.5, "cycles": 3},
    }

    def with_moment(**values):
        leg = {"kind": "leg", "moment": {"kind": "gait", "cycles": 6} | values}
        return Scenario(**walking, wearer=leg)

    scenario = with_moment(frequency_hz=0.5, body_mass_kg=60.0)
    message = r"frequency_hz = 0.25 Hz, must be 0.5 Hz, the frequency of reference: gait$"
    with pytest.raises(ParameterError, match=message):
        with_moment(frequency_hz=0.25)
    with pytest.raises(ParameterError, match=r"must be 0.8 Hz, the frequency of reference: gait$"):
        scenario.changed({"reference": gait_reference(0.8, 3)})
    times, moments = scenario.wearer.moment.times_s, scenario.wearer.moment.moments_n_m
    other = {"times_s": times, "moments_n_m": (*moments[:-1], 0.9 * moments[-1] + 1.0)}
    scenario.changed({"reference": gait_reference(0.8, 3), "wearer.moment": other})


def test_reference_and_moment_of_one_trial_have_one_clock(tmp_path):
    rows = [(12.3 + 0.1 * n, n - 5.0) for n in range(21)]
    for name, column in (("ik.csv", "knee_angle_deg"), ("id.csv", "knee_moment_nm")):
        lines = [f"time_s,{column}", *(f"{time:.1f},{value}" for time, value in rows)]
        (tmp_path / name).write_text("\n".join(lines), encoding="utf-8")
    path = tmp_path / "my.yaml"
    reference = "{kind: csv, file: ik.csv, clip: true}"
    text = f"preset: wearer\nreference: {reference}\nwearer: {{moment: id.csv}}"
    path.write_text(text, encoding="utf-8")
    scenario = load_scenario(path)
    assert scenario.duration_s == 2.0
    assert (scenario.reference.shift_s, scenario.reference.clipped_deg) == (12.3, 5.0)
    assert scenario.reference.range_deg == (0.0, 15.0)
    assert scenario.reference.times_s == scenario.wearer.moment.times_s
    assert scenario.wearer.moment.times_s[:3] == (0.0, 0.1, 0.2)
    # A change of another value shifts nothing again, and a new file of the moment is shifted.
    assert scenario.changed({"encoder.quantized": False}).wearer == scenario.wearer
    assert scenario.changed({"wearer.moment": str(tmp_path / "id.csv")}) == scenario
    path.write_text(text.replace("id.csv", "{file: id.csv, shift_s: 12.0}"), encoding="utf-8")
    with pytest.raises(ParameterError, match=r"wearer.moment covers 0.3 … 2.3 s, .* 0 to 2 s"):
        load_scenario(path)


def test_clip_sets_samples_to_the_ends_of_the_range_of_motion():
    samples = {"times_s": (0, 1, 2, 3, 4), "angles_deg": (20, -5, 10, 93, 20), "clip": True}
    scenario = Scenario(reference={"kind": "samples", **samples})
    assert scenario.reference.angles_deg == (20.0, 0.0, 10.0, 90.0, 20.0)
    assert scenario.reference.clipped_deg == 5.0
    narrow = scenario.changed({"plant.knee.flexion_max_deg": 60.0}).reference
    assert (narrow.angles_deg, narrow.clipped_deg) == ((20.0, 0.0, 10.0, 60.0, 20.0), 30.0)
    assert Scenario(**dict(scenario)) == scenario


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "push: plant.load.kind must be knee"),
        ({"plant": {"load": "knee"}, "wearer": "leg"}, "push: wearer.kind must be none, not leg"),
        (
            {"plant": {"load": "knee"}, "simulation": {"duration_s": 10.1}},
            r"push ends at 10.2 s, and the run lasts 10.1 s; must end within the run",
        ),
    ],
)
def test_a_push_needs_a_load_and_a_run_that_contains_it(values, message):
    with pytest.raises(ParameterError, match=message):
        Scenario.model_validate(values | {"push": {"torque_n_m": 5.0}})
    # The last one would lie between two samples of the controller.
    for duration_s in (-1.0, 0.0, 0.0019):
        with pytest.raises(ParameterError, match=r"push\.duration_s.* must be"):
            Scenario.model_validate({"plant": {"load": "knee"}, "push": {"duration_s": duration_s}})
