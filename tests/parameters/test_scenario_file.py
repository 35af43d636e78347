"""Scenario files: what loads, what one line each fault gives, and the round trip."""

from __future__ import annotations

import json
import re
import types
import typing
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings, strategies as st

from kneexo.errors import OutputError, ScenarioError
from kneexo.parameters import (
    G2,
    CylinderParameters,
    EncoderParameters,
    ExactParameters,
    KneeLoadParameters,
    KneeParameters,
    Law,
    LawParameters,
    LegParameters,
    LoadCellParameters,
    MomentTable,
    NoWearer,
    PidParameters,
    PlantParameters,
    RodPolynomialParameters,
    SampledReference,
    Scenario,
    SimulationParameters,
    SineReference,
    SlidingModeParameters,
    ThermalParameters,
    TorqueParameters,
    scenario_file,
)
from kneexo.parameters.device.parts import PartMaker
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.scenario_file import dump_scenario, load_scenario, read_value, scenario_files
from kneexo.studies.paper import IDEAL_SMC

_KINDS = "'smc', 'pid', 'torque' or 'law'"

OWN_LAW = Path(__file__).parents[2] / "examples" / "own_law.py"

NAME = "scenario.yaml"


class File:
    """A scenario file in a temporary directory, rewritten for every text."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / NAME

    def load(self, text: str | bytes) -> Scenario:
        self.path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_scenario(self.path)

    def fault(self, text: str | bytes) -> str:
        with pytest.raises(ScenarioError) as caught:
            self.load(text)
        return self.line(caught.value)

    def line(self, error: ScenarioError) -> str:
        message = str(error)
        assert message.isprintable()  # neither a newline nor a control character
        assert message.startswith(f"{self.path}:")
        return message.replace(str(self.path), NAME)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> File:
    return File(tmp_path_factory.mktemp("scenario"))


# --------------------------------------------------------------------------- what loads


@pytest.mark.parametrize(
    "text", ["", "\n", "# only a comment\n", "---\n", "~", "{}", "\ufeffplant: {}"]
)
def test_empty_file_is_the_default_scenario(file: File, text: str) -> None:
    assert file.load(text) == Scenario()


def test_path_may_be_text(file: File) -> None:
    file.load("bus: {latency_samples: 2}")
    assert load_scenario(str(file.path)).bus.latency_samples == 2


EVERY_SECTION = """
plant: &plant
  pump: {lag_s: 0.02}
  cylinder: {mass_kg: 1.8}
  linkage: G2
  knee: {flexion_max_deg: 80}
  load: {kind: knee, disturbance_n: 5}
  rod_map: polynomial
  ideal_motor: true
nominal: *plant
polynomial:
  p_mm_deg: [1, 2, 3, 4, 5, 6.5]
encoder: {quantized: false, counts_per_revolution: 2048}
estimator: {kind: exact}
controller:
  kind: smc
  continuous: true
reference:
  kind: samples
  times_s:
    - 0
    - 1
    - 2.5
  angles_deg: [10, 20, 15]
initial_offset_m: -0.01
simulation: {integrator: radau1, duration_s: 1e1}
"""


def test_every_section_loads_and_the_rest_is_default(file: File) -> None:
    plant = PlantParameters(
        pump={"lag_s": 0.02},
        cylinder=CylinderParameters(mass_kg=1.8),
        linkage=G2,
        knee=KneeParameters(flexion_max_deg=80.0),
        load=KneeLoadParameters(disturbance_n=5.0),
        rod_map="polynomial",
        ideal_motor=True,
    )
    assert file.load(EVERY_SECTION) == Scenario(
        plant=plant,
        nominal=plant,
        polynomial=RodPolynomialParameters(p_mm_deg=(1.0, 2.0, 3.0, 4.0, 5.0, 6.5)),
        encoder=EncoderParameters(quantized=False, counts_per_revolution=2048),
        estimator=ExactParameters(),
        controller=SlidingModeParameters(continuous=True),
        reference=SampledReference(times_s=(0.0, 1.0, 2.5), angles_deg=(10.0, 20.0, 15.0)),
        initial_offset_m=-0.01,
        simulation=SimulationParameters(integrator="radau1", duration_s=10.0),
    )


@pytest.mark.parametrize(
    ("scalar", "value"),
    [
        ("1e5", 1e5),
        ("1E+5", 1e5),
        ("1.72e9", 1.72e9),
        ("172e7", 1.72e9),
        ("1.e3", 1e3),
        (".5", 0.5),
        ("+3", 3.0),
        ("010", 10.0),
        ("100000000000", 1e11),
    ],
)
def test_numbers_as_in_yaml_1_2(file: File, scalar: str, value: float) -> None:
    controller = file.load(f"controller: {{eta_m_s3: {scalar}}}").controller
    assert isinstance(controller, SlidingModeParameters)
    assert controller.eta_m_s3 == value


@pytest.mark.parametrize("scalar", ["yes", "1:30", "2020-01-01", "1_000", "'1.5'", "1e", "0x10"])
def test_text_as_in_yaml_1_2(file: File, scalar: str) -> None:
    line = file.fault(f"simulation: {{duration_s: {scalar}}}")
    shown = scalar.strip("'")
    assert line.startswith(f"scenario.yaml:1: simulation.duration_s = '{shown}': must be")


def test_yaml_s_own_loader_is_left_alone(file: File) -> None:
    assert yaml.safe_load("[1e5, yes, 1.5]") == ["1e5", True, 1.5]


# ------------------------------------------------------------------------- what is wrong

KNOWN = ", ".join(sorted(Scenario.model_fields))
NO_MASS = "has no value: must be a number, >= 0.01 and <= 1000 kg"
NO_PART = "has no value: must be a mapping of names to values, such as {%s: …}"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (  # ranges and types
            "# shank\n\nplant:\n  cylinder:\n    bore_m: 0.02\n    mass_kg: -1\n",
            "6: plant.cylinder.mass_kg = -1 kg is out of range: "
            "must be finite and >= 0.01 and <= 1000 kg",
        ),
        (
            "plant:\n  cylinder: {stroke_m: 0.1,\n    mass_kg: heavy}\n",
            "3: plant.cylinder.mass_kg = 'heavy': must be a number, >= 0.01 and <= 1000 kg",
        ),
        (
            "reference:\n  kind: samples\n  angles_deg: [1, 2, 3, 4]\n  times_s:\n"
            "  - 0\n  - soon\n  - 2\n  - 3\n",
            "6: reference.times_s.1 = 'soon': must be a number in s",
        ),
        (
            "plant:\n  pump:\n    lag_s: 9\n    gear_ratio: 0\n",
            "3: plant.pump.lag_s = 9 s is out of range: must be finite and >= 0.0001 and <= 1 s "
            "(and 1 more)",
        ),
        (
            "plant: &p\n  cylinder: &c\n    mass_kg: 1\nnominal:\n  cylinder: *c\n  knee: *c\n",
            "3: nominal.knee.mass_kg: unknown name; did you mean nominal.cylinder.mass_kg?",
        ),
        # values that contradict each other
        (
            "plant:\n  knee:\n    flexion_min_deg: 90\n",
            "2: plant.knee: flexion_min_deg = 90 deg must be below flexion_max_deg = 90 deg",
        ),
        (
            "# fig. 9\ncontroller:\n  continuous: true\n",
            "2: controller.continuous = true needs estimator.kind = exact, not observer",
        ),
        # missing values
        ("plant:\n  cylinder:\n    mass_kg:\n", f"3: plant.cylinder.mass_kg {NO_MASS}"),
        ("plant:\n  cylinder:\n", f"2: plant.cylinder {NO_PART % 'bore_m'}"),
        ("plant:\n  load:\n", "2: plant.load has no value: must be none, knee or a mapping"),
        (
            "encoder: {}\nreference:\n  kind: samples\n",
            "2: reference.times_s: is missing; must be given by the user; strictly increasing "
            "(and 1 more)",
        ),
        # unknown names
        ("encoder: {}\nqqq: 1\n", f"2: qqq: unknown name; known here: {KNOWN}"),
        ('"plant\\n": {}\n', "1: plant\\n: unknown name; did you mean plant?"),
        # names that are wrong in YAML itself
        (
            "plant:\n  cylinder:\n    mass_kg: 1\n    bore_m: 0.03\n    mass_kg: 1\n",
            "5: plant.cylinder.mass_kg: duplicate name, first on line 3",
        ),
        ("plant: {}\n'plant': {}\n", "2: plant: duplicate name, first on line 1"),
        ("plant:\n  1: 2\n", "2: plant: a name must be text, not 1"),
        ("true: 2\n", "1: a name must be text, not true"),
        ("{~: 2}\n", "1: a name must be text, not ~"),
        ("?\n: 2\n", "1: a name must be text, not null"),
        ("\n? [1, 2]\n: 3\n", "2: a name must be text, not a list or mapping"),
        ("? {a: b}\n: 3\n", "1: a name must be text, not a list or mapping"),
        # the document
        ("# list\n- plant\n", "2: the top level must be a mapping, not a list"),
        ("plant\n", "1: the top level must be a mapping, not a single value"),
        (
            "plant: {}\n---\nplant: {}\n",
            "2: YAML syntax, column 1: expected a single document in the stream, "
            "but found another document",
        ),
        (
            "plant:\n  pump: {lag_s: 1\n  knee: {}\n",
            "3: YAML syntax, column 7: while parsing a flow mapping, expected ',' or '}', "
            "but got ':'",
        ),
        (
            "plant:\n\tpump: 1\n",
            "2: YAML syntax, column 1: while scanning for the next token, "
            "found character '\\t' that cannot start any token",
        ),
        ("plant: *p\n", "1: YAML syntax, column 8: found undefined alias 'p'"),
        ("plant: {}\n\n# \x07\n", "3: YAML syntax: '\\x07': special characters are not allowed"),
        (b"plant: {}\n# caf\xe9\n", "2: is not UTF-8: byte 0xe9; save it as UTF-8"),
        (
            "plant: !!python/object:os.system {}\n",
            "1: plant: tag 'tag:yaml.org,2002:python/object:os.system' is not supported",
        ),
        ("plant: {ideal_motor: !yes true}", "1: plant.ideal_motor: tag '!yes' is not supported"),
    ],
)
def test_fault_is_one_line_with_file_line_and_path(
    file: File, text: str | bytes, line: str
) -> None:
    assert file.fault(text) == f"scenario.yaml:{line}"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("controller: {kind: }", ["controller.kind", _KINDS]),
        ("encoder: &e {quantized: *e}", ["encoder.quantized.quantized", "too deep"]),
        ("plant: &a [*a]", ["plant.0.0.0", "too deep"]),
        ("polynomial: {p_mm_deg: [1, 2, 3]}", ["polynomial.p_mm_deg has 3 values: must have 6"]),
        (
            "polynomial: {p_mm_deg: [1, 2, 3, 4, 5, 6, 7]}",
            ["polynomial.p_mm_deg has 7 values: must have at most 6"],
        ),
        ("polynomial: {p_mm_deg: 1}", ["polynomial.p_mm_deg = 1"]),
        ("plant: {rod_map: 'a\\u2028\nb'}", ["plant.rod_map"]),
        ('a: "\\UFFFFFFFF"', ["YAML syntax"]),
        ('a: "\\ud800"', ["a: unknown name"]),
        ("%YAML " + "1" * 5000 + ".1\n---\na", ["YAML syntax"]),
        ("simulation: {duration_s: " + "1" * 5000 + "}", ["simulation.duration_s = inf s"]),
    ],
)
def test_the_message_of_a_fault_on_line_1_has_all_its_parts(
    file: File, text: str, parts: list[str]
) -> None:
    message = file.fault(text)
    assert message.startswith(("scenario.yaml:1: ", "scenario.yaml: YAML"))
    assert all(part in message for part in parts), message


@pytest.mark.slow
def test_each_wrong_value_is_reported_on_its_line(file: File) -> None:
    lines = dump_scenario(Scenario()).splitlines()
    path: list[str] = []
    for n, line in enumerate(lines):
        name, value = line.split("#")[0].split(":")
        path[name.count("  ") :] = [name.strip()]
        if value.strip() and path[-1] != "kind":
            wrong = [*lines[:n], f"{name}: [[]]", *lines[n + 1 :]]
            message = file.fault("\n".join(wrong))
            assert message.startswith(f"scenario.yaml:{n + 1}: {'.'.join(path)}")


@pytest.mark.parametrize("depth", [25, 5_000])
def test_nesting_without_end_is_a_fault(file: File, depth: int) -> None:
    file.fault("a: " + "[" * depth + "]" * depth)


def test_aliases_cannot_multiply_a_text_without_end(
    file: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenario_file, "_MOST_VALUES", 1000)
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
    assert "too many values" in file.fault("\n".join(lines))
    assert "too many values" in file.fault(f"a: &a [{', '.join('x' * 600)}]\nb: *a")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (" " * (2**20 + 1), "cannot be read: is too large, must have at most 1048576 bytes"),
        ("\n".join(["- 1"] * 2100), "too deep or too many values"),
        ("a: " + "[" * 400_000, "1: too deep or too many values"),
    ],
)
def test_large_files_are_refused_before_their_end_is_read(
    file: File, text: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenario_file, "_MOST_VALUES", 1000)
    assert message in file.fault(text + "\n}")  # a syntax error, where it is read


@pytest.mark.parametrize(
    "text",
    [
        f"{'a' * 100_000}: 1",
        f"controller: {{kind: {'a' * 100_000}}}",
        f"plant: {{linkage: {'a' * 100_000}}}",
        f"a: !{'a' * 1000} 1",
        f"{'1' * 1000}: 1",
        f"a: *{'a' * 100_000}",
    ],
)
def test_a_fault_is_a_short_line(file: File, text: str) -> None:
    assert len(file.fault(text)) < 900


def test_a_setting_is_a_single_value() -> None:
    assert read_value("--set seed", "[1, 2]") == (1, 2)
    for text in ("1\nx: 2", "1\n...\n---\n2"):
        with pytest.raises(ScenarioError, match=r"^--set seed"):
            read_value("--set seed", text)


WORDS = sorted({*re.split(r"(\W)", EVERY_SECTION), *"'\"|>?!%@\\~.", "---", "\n  ", ": ", "<<"})


@st.composite
def damaged(draw: st.DrawFn) -> str:
    """The scenario of every section, with some parts exchanged."""
    text = EVERY_SECTION
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        word = draw(st.sampled_from(WORDS))
        text = text[:start] + word + text[start + draw(st.integers(0, 12)) :]
    return text


def require_scenario_or_line(file: File, text: str) -> None:
    """A text becomes a scenario, or its fault is one line."""
    try:
        assert isinstance(file.load(text.encode(errors="surrogatepass")), Scenario)
    except ScenarioError as error:
        file.line(error)


TEXTS = st.one_of(damaged(), st.text(max_size=20))


@settings(max_examples=20)
@given(text=TEXTS)
def test_any_text_is_a_scenario_or_one_line(file: File, text: str) -> None:
    require_scenario_or_line(file, text)


@pytest.mark.slow
@settings(max_examples=200)
@given(text=TEXTS)
def test_each_of_many_texts_is_a_scenario_or_one_line(file: File, text: str) -> None:
    require_scenario_or_line(file, text)


# ---------------------------------------------------------------------------- round trip

ORDERED = {
    KneeParameters: ("flexion_min_deg", "flexion_max_deg"),
    SlidingModeParameters: ("mass_min_kg", "mass_max_kg"),
    ThermalParameters: ("derating_min_degc", "derating_max_degc"),
}


def values_of(annotation: typing.Any, bounds: dict[str, float]) -> st.SearchStrategy[typing.Any]:
    """Random valid values of a field."""
    arguments = typing.get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, Parameters):
        return instances_of(annotation)
    if annotation is type(None):
        return st.none()
    if annotation is bool:
        return st.booleans()
    if annotation in (Law, PartMaker):
        return st.just(annotation.from_text(f"{OWN_LAW}:law"))
    if annotation is int:
        return st.integers(bounds["ge"], bounds["le"])
    if annotation is float:
        low = bounds.get("gt", bounds.get("ge"))
        return st.floats(low, bounds.get("le"), exclude_min="gt" in bounds, allow_nan=False)
    origin = typing.get_origin(annotation)
    if origin is typing.Literal:
        return st.sampled_from(arguments)
    if origin is dict:
        names = st.from_regex(r"[a-z0-9_]{1,6}", fullmatch=True)
        return st.dictionaries(names, st.floats(allow_nan=False, allow_infinity=False), max_size=3)
    if origin is tuple:
        number = st.floats(-1e4, 1e4)  # the coefficients of Table 1
        return st.tuples(*[number for _ in arguments])
    assert origin in {types.UnionType, typing.Union}, annotation
    return st.one_of([values_of(member, bounds) for member in arguments])


def instances_of(model: type[Parameters]) -> st.SearchStrategy[Parameters]:
    """Random valid instances of a parameter class."""
    if model is SampledReference:
        times = st.lists(
            st.integers(0, 10**6).map(lambda n: 1e-3 * n), min_size=3, max_size=6, unique=True
        ).map(sorted)
        return times.map(lambda t: SampledReference(times_s=tuple(t), angles_deg=(1.5,) * len(t)))
    fields = {}
    for name, field in model.model_fields.items():
        bounds = {
            key: getattr(bound, key)
            for bound in field.metadata
            for key in ("ge", "gt", "le")
            if getattr(bound, key, None) is not None
        }
        fields[name] = values_of(field.annotation, bounds)
    if model is SlidingModeParameters:
        fields["continuous"] = st.just(False)  # True asks for exact states
    if model is LawParameters:  # its function has one gain and no state
        fields["values"] = st.fixed_dictionaries({"gain": st.floats(-1e6, 1e6)})
        fields["initial_state"] = st.just(())
    if model is Scenario:  # a moment must cover the run
        fields["wearer"] = st.just(NoWearer()) | instances_of(LegParameters)
        fields["faults"] = st.just(())  # whose times and places depend on all others
        fields["protection"] = st.just(None)  # whose thresholds depend on the encoder
    if model is LegParameters:
        fields["loss_modulus_n_m_per_rad"] = st.just(0.0)
        fields["effort"] = st.just(1.0)
    if model is MomentTable:
        fields = {"times_s": st.just((-1.0, 1e5)), "moments_n_m": st.just((3.0, -4.0))}

    def build(drawn: dict[str, typing.Any]) -> Parameters:
        if model in (PidParameters, TorqueParameters):
            drawn["anti_windup_s"] = max(drawn["anti_windup_s"], drawn["sample_time_s"])
        if model is Scenario:  # the reference must lie within the range of motion
            low, high = drawn["reference"].range_deg
            knee = drawn["plant"].knee
            if low < knee.flexion_min_deg or high > knee.flexion_max_deg:
                del drawn["reference"], drawn["plant"]
            jumps = "reference" in drawn and drawn["reference"].kind == "step"
            if jumps or drawn.get("plant", PlantParameters()).load.kind == "none":
                del drawn["wearer"]  # a prescribed leg cannot jump, and a cuff acts on a load
            del drawn["push"]  # needs a load, and a run that is long enough
            law, leg = drawn["controller"], drawn.get("wearer", NoWearer())
            if law.kind == "torque" and getattr(leg, "moment", None) is None:
                drawn["controller"] = law.model_copy(update={"mode": "impedance"})
        if model is PlantParameters:
            if drawn["full_order"] is None:
                del drawn["bypass"]
            if drawn["ideal_motor"]:
                drawn["motor"] = None
            if drawn["motor"] is None:
                del drawn["thermal"]
        if model is SimulationParameters and drawn["integrator"] == "rosenbrock":
            del drawn["tolerance"]  # its least value is larger
        if model is LoadCellParameters and drawn["seed"] is None:
            del drawn["noise_n"]
        if model is SineReference and drawn["ramp_s"] < 1e-3:
            del drawn["ramp_s"]
        if model is CylinderParameters and drawn["rod_diameter_m"] > 0.98 * drawn["bore_m"]:
            del drawn["rod_diameter_m"], drawn["bore_m"]
        low, high = ORDERED.get(model, (None, None))
        if low and drawn[low] >= drawn[high]:  # then both have their default
            del drawn[low], drawn[high]
        return model(**drawn)

    return st.fixed_dictionaries(fields).map(build)


@settings(max_examples=5)
@given(scenario=instances_of(Scenario))
def test_round_trip(file: File, scenario: Scenario) -> None:
    assert again(file, scenario) == scenario


@pytest.mark.slow
@settings(max_examples=60)
@given(scenario=instances_of(Scenario))
def test_round_trip_of_many(file: File, scenario: Scenario) -> None:
    assert again(file, scenario) == scenario


def again(file: File, scenario: Scenario) -> Scenario:
    """Return the scenario of a file, beside which lie the files of a law."""
    files = scenario_files(scenario, "scenario.yaml")
    text = files.pop("scenario.yaml")
    for name, content in files.items():
        (file.path.parent / name).write_bytes(content)
    return file.load(text)


@pytest.mark.parametrize(
    "scenario",
    [Scenario(), IDEAL_SMC, Scenario(polynomial=RodPolynomialParameters())],
    ids=["default", "ideal", "polynomial"],
)
def test_any_yaml_reader_understands_a_dump(scenario: Scenario) -> None:
    plain = yaml.safe_load(dump_scenario(scenario))
    # A tuple is a list in YAML.
    assert plain == json.loads(scenario.model_dump_json())


def test_small_and_large_floats_are_floats_in_yaml_1_1(file: File) -> None:
    scenario = Scenario(
        plant=PlantParameters(pump={"displacement_m3_per_rad": 1e-5}),
        polynomial=RodPolynomialParameters(p_mm_deg=(1e-20, -3e3, 1.5e-7, 12e-300, 5e-324, -0.0)),
    )
    text = dump_scenario(scenario)
    assert "displacement_m3_per_rad: 1.0e-05" in text
    assert yaml.safe_load(text)["polynomial"]["p_mm_deg"] == list(scenario.polynomial.p_mm_deg)
    assert file.load(text) == scenario


def test_dump_is_documented() -> None:
    lines = dump_scenario(Scenario()).splitlines()
    assert "    mass_kg: 1.6  # kg, >= 0.01 and <= 1000" in lines
    assert "controller:  # kind: smc, pid, torque, law" in lines
    assert "  rod_map: linkage  # linkage, polynomial" in lines
    assert "nominal: null" in lines
    (line,) = (line for line in lines if line.startswith("polynomial: null  # "))
    assert "left out: Table 1" in line
    (line,) = (line for line in lines if line.startswith("  duration_s: null  # s, >= 0.001"))
    assert "left out: to the last sample" in line
    assert "  ideal_motor: false" in lines


# ---------------------------------------------------------------------------- csv files


def test_a_csv_reference_is_relative_to_the_scenario_file(tmp_path, monkeypatch):
    (tmp_path / "gait.csv").write_text("time_s,knee_angle_deg\n0,10\n1,20\n2,15\n")
    monkeypatch.chdir("/")
    scenario = File(tmp_path).load("\nreference: {kind: csv, file: gait.csv}")
    assert scenario.reference == SampledReference(times_s=(0, 1, 2), angles_deg=(10, 20, 15))
    assert File(tmp_path).load(dump_scenario(scenario)) == scenario


def test_a_faulty_csv_reference_names_both_files(tmp_path):
    line = File(tmp_path).fault("\nreference: {kind: csv, file: none.csv}")
    assert line.startswith(f"{NAME}:2: reference: {tmp_path}/none.csv: cannot be read")


def test_a_copy_of_a_law_replaces_an_earlier_copy_but_no_code_of_the_user(tmp_path):
    (tmp_path / "law.py").write_text("def law(rod_extension):\n    return 0.0\n")
    law = Scenario().with_law(f"{tmp_path}/law.py:law")
    out = tmp_path / "out"
    out.mkdir()
    files = scenario_files(law, "scenario.yaml", out)
    assert files["law.py"] == (tmp_path / "law.py").read_bytes()
    (out / "law.py").write_text("# the user's own\n")
    with pytest.raises(OutputError, match=r"out: has another law\.py than law law\.py:law; choose"):
        scenario_files(law, "scenario.yaml", out)
    (out / "scenario.yaml").write_text(files["scenario.yaml"])
    assert scenario_files(law, "scenario.yaml", out) == files
