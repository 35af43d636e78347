"""What each study of the catalogue promises, whatever it computes.

What a study shows of its results is in test_shown.py, its files and options are in
tests/command_line/test_studies.py.
"""

import importlib
import json
import math
import re
from concurrent.futures import Executor
from pathlib import Path

import numpy as np
import pytest

from kneexo.command_line.main import main
from kneexo.command_line.output import to_json
from kneexo.command_line.parameter_list import parameter_rows, setting_rows
from kneexo.errors import KneexoError
from kneexo.parameters import GAIT2392, HINGE, Scenario, UncertaintySet
from kneexo.parameters.paths import changed
from kneexo.studies.catalogue import STUDIES
from kneexo.sweeps import Checkpoint


class NoRuns(Executor):
    """Workers that may not be asked for a run."""

    def submit(self, *_, **__):
        raise AssertionError("a run began")


@pytest.mark.parametrize("name", STUDIES)
def test_params_lists_each_setting_and_the_help_names_the_list(name, capsys):
    study = STUDIES[name]
    label = study.label or study.command
    own = [f"{label}: {row['parameter']}" for row in parameter_rows(study.computation().settings())]
    assert own
    assert set(own) <= {row["parameter"] for row in setting_rows()}
    with pytest.raises(SystemExit):
        main([*study.command.split(), "--help"])
    assert f"with their defaults after '{label}:'" in " ".join(capsys.readouterr().out.split())


def check_rules(results, flat):
    """Check what holds for each number with such a name, at any depth."""
    for path, value in flat(results).items():
        if isinstance(value, float) and math.isfinite(value):
            name = next(part for part in reversed(path.split("/")) if not part.isdigit())
            if re.search(r"(^|_)share(s|$|_)", name):
                assert 0.0 <= value <= 1.0, path
            if re.match(r"(rms|max|peak|worst)_.*error|.*_swing_|rod_speed", name):
                assert value >= 0.0, path
    if isinstance(results, dict):
        for key, value in results.items():
            seconds = results.get(f"{key[:-3]}_s") if key.endswith("_ms") else None
            if isinstance(seconds, float) and math.isfinite(seconds):
                assert value == pytest.approx(1e3 * seconds), key
            check_rules(value, flat)
    elif isinstance(results, list | tuple):
        for value in results:
            check_rules(value, flat)


@pytest.fixture
def made_up(name):
    return importlib.import_module(f"{name}_cases").made_up()


@pytest.mark.parametrize("name", STUDIES)
def test_results_are_json_without_nan_and_keep_the_rules_of_their_names(made_up, flat):
    results = made_up.results()
    check_rules(results, flat)
    plain = json.loads(to_json(results), parse_constant=pytest.fail)
    assert plain.keys() == results.keys()


@pytest.fixture
def small(name, computed):
    """As in the folder of the study."""
    return computed(name)


QUICK = (("contest", 1), ("contest", 2))
"""Studies that a fast test may hold, with one in so many of their pieces finished."""
INTERRUPTED = [
    pytest.param(name, part, marks=() if (name, part) in QUICK else pytest.mark.slow)
    for name in STUDIES
    if STUDIES[name].resumable
    for part in (1, 2)
]


@pytest.mark.parametrize(("name", "part"), INTERRUPTED)
def test_a_study_goes_on_from_its_finished_pieces_and_gives_the_same(name, part, small, tmp_path):
    study, shown, (result, path) = STUDIES[name].computation(), STUDIES[name].presentation(), small
    pieces = path.read_bytes().splitlines(keepends=True)
    again = tmp_path / "checkpoint.jsonl"
    again.write_bytes(b"".join(pieces[: len(pieces) // part]))
    checkpoint = Checkpoint(again, resume=True)
    assert len(checkpoint) == len(pieces) // part
    arguments = importlib.import_module(f"{name}_cases").SMALL_STUDY
    executor = NoRuns() if part == 1 else None
    resumed = study.compute(**arguments, checkpoint=checkpoint, executor=executor)
    assert to_json(resumed.results()) == to_json(result.results())
    assert shown.report(resumed) == shown.report(result)
    assert len(again.read_bytes().splitlines()) == len(pieces)
    for (_, columns), (_, before) in zip(
        shown.motions(resumed).values(), shown.motions(result).values(), strict=True
    ):
        assert columns.keys() == before.keys()
        assert all(np.array_equal(columns[name], before[name]) for name in before)


# ------------------------------------------------------------------------------- bad input

HIGH = {"reference": {"kind": "sine", "mean_deg": 85.0, "amplitude_deg": 1.0}}
CONTINUOUS = {
    "encoder.quantized": False,
    "estimator": "exact",
    "controller.continuous": True,
}
OWN_LAW = Path(__file__).parents[2] / "examples" / "own_law.py"
LAW = {"controller": {"kind": "law", "function": f"{OWN_LAW}:law"}}
TORN = HINGE.model_copy(update={"a_2_m": 70e-3})
SHORT_KNEE = GAIT2392.changed({"up_angles_rad": (0.0, 0.5, 1.0), "up_m": (-0.4, -0.405, -0.41)})
ESTOP = {"place": "emergency_stop", "kind": "value", "size": 1.0}
REFUSED = (
    # scenarios
    ("bandwidth", {"reference": "ramp"}, {}, "reference = ramp"),
    ("controller", {"controller": "pid"}, {}, "controller.kind = pid: must be a sampled smc"),
    ("controller", CONTINUOUS, {}, "controller.kind = smc: must be a sampled smc"),
    ("controller", {"estimator": "difference"}, {}, "estimator.kind = difference: must be"),
    ("controller", HIGH, {}, "end_deg = 95 deg is"),
    ("contest", LAW, {}, "controller.kind = law: .* 'A fair contest'"),
    ("size", {"reference": "ramp"}, {}, "reference = ramp"),
    ("size", {"controller": "pid"}, {}, "controller.kind = pid"),
    ("size", {"estimator": "difference"}, {}, "estimator.kind = difference"),
    ("size", {"plant.ideal_motor": True}, {}, "plant.ideal_motor = true"),
    ("faults", {"faults": ({"place": "encoder"},)}, {}, "faults, push: must be left out"),
    (
        "faults",
        {"plant.load": "knee", "push": {"torque_n_m": 1.0}},
        {},
        "faults, push: must be left out",
    ),
    ("mechanism", {"plant.linkage": TORN}, {}, "cannot be assembled"),
    (
        "wearer",
        {},
        {},
        r"^wearer.kind = none, controller.kind = smc: must be leg and torque; add wearer: leg, "
        r"controller: torque$",
    ),
    # settings
    ("bandwidth", {}, {"frequencies_hz": (1, 2, 51)}, "51 Hz is too high: must be <= 50 Hz"),
    ("bandwidth", {}, {"amplitudes_deg": (1.0, 45.0)}, "leaves the range of motion"),
    ("bandwidth", {}, {"amplitudes_deg": (1.0, 50.0)}, r"amplitudes_deg\.1 = 50 deg is out of ran"),
    *(
        ("bandwidth", {}, {name: values}, rf"{name}(: must increase|\.0 = 0 \w+ is out of range)")
        for name in ("amplitudes_deg", "frequencies_hz")
        for values in ((1.0, 3.0, 2.0), (1.0, 1.0, 2.0), (0.0, 1.0, 2.0))
    ),
    ("controller", {}, {"step_deg": 0.2}, r"settling_band_deg = 0\.2 deg: must be less than"),
    ("controller", {}, {"etas_m_s3": (2.0, 1.0)}, "etas_m_s3: must increase"),
    ("controller", {}, {"lambdas_per_s": (-1.0, 1.0)}, "lambdas_per_s"),
    ("contest", {}, {"population": 4}, "population = 4 is out of range"),
    ("contest", {}, {"contestants": {}}, "contestants"),
    ("contest", {}, {"optimizer_seeds": ()}, "optimizer_seeds"),
    ("contest", {}, {"least_disk_margin": 0.0}, "least_disk_margin = 0 is out of range"),
    ("contest", {}, {"training_samples": 0}, "training_samples = 0 is out of range"),
    ("size", {}, {"factors": (1.0, 1.0)}, "factors: must increase"),
    ("size", {}, {"walking_factors": (2.0, 1.0)}, "walking_factors: must increase"),
    ("size", {}, {"factors": ()}, "factors has 0 values: must have at least 1"),
    ("size", {}, {"acceleration_limit_min_rad_s2": 1e5}, r"_s2 = 100000 rad/s² must be below"),
    ("size", {}, {"cycles": 1}, "cycles = 1 is out of range: must be finite and >= 2 and <= 1000"),
    ("faults", {}, {"faults": (ESTOP,)}, "place = emergency_stop: must be left out; the study"),
    ("mechanism", {}, {"knee": "no.csv"}, "knee: .*no.csv: cannot be read: No such file"),
    ("mechanism", {}, {"knee": "left"}, "knee = 'left': must be gait2392, the path of"),
    ("mechanism", {}, {"knee": SHORT_KNEE}, "must have them at 58 deg; add nodes"),
    ("fit", {}, {}, r"^log: must be the path of a CSV file: kneexo fit LOG\.csv MINE\.yaml$"),
    ("design", {}, {"rod": "Table 1"}, "rod = Table 1: must be table_1, none or a path"),
)
"""Study, changes of the default scenario and of the settings, and the message."""


@pytest.mark.parametrize(("name", "values", "settings", "message"), REFUSED)
def test_what_a_study_cannot_do_is_refused_in_one_line_before_any_run(
    name, values, settings, message
):
    study = STUDIES[name].computation()
    scenario = changed(Scenario(), values)

    def called():
        chosen = changed(study.settings(), settings)
        return study.compute(scenario, settings=chosen, executor=NoRuns())

    with pytest.raises(KneexoError, match=message) as caught:
        called()
    assert "\n" not in str(caught.value)


INTERVAL = {"low": 1.0, "high": 2.0}
WRONG_SETS = {
    "plant.cylinder.mas_kg": (INTERVAL, r": unknown name; .* plant\.cylinder\.mass_kg\?"),
    "nonsense": (INTERVAL, ": unknown name; .*"),
    "plant.cylinder.mass_kg": ({"low": -1.0, "high": 2.0}, " = -1 kg is out of range: .*"),
    "plant.linkage": ({"options": ("G1", "G9")}, " = 'G9': must be G1, .*"),
    "bus.latency_samples": ({"options": (1,), "known": True}, ": known is for values of the plant"),
    "plant.pump.lag_s": ({"low": 0.01, "high": 0.02}, ": lies within plant.pump, .*"),
    "plant.load.segment_mass_kg": (INTERVAL, ""),
}


@pytest.mark.parametrize("path", WRONG_SETS)
@pytest.mark.parametrize("name", [study.name for study in STUDIES.values() if study.uncertain])
def test_a_wrong_uncertainty_set_is_refused_in_one_line_before_any_run(name, path):
    values, message = WRONG_SETS[path]
    pump = {"plant.pump": {"options": ({},)}} if path == "plant.pump.lag_s" else {}
    wrong = UncertaintySet(values=pump | {path: values})
    line = re.escape(path) + message
    if path == "plant.load.segment_mass_kg":
        line = f"none of the uncertain values is in this scenario: .*{line}"
    with pytest.raises(KneexoError, match=rf"\A{line}\Z"):
        STUDIES[name].computation().compute(Scenario(), uncertainty=wrong, executor=NoRuns())
