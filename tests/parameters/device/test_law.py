"""Control laws of the user: names, files, arguments, errors."""

import json
import math
import pickle
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import Gain

from kneexo.errors import ParameterError, ScenarioError
from kneexo.law import FunctionLaw_
from kneexo.parameters import Law, LawParameters, Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import (
    dump_scenario,
    load_scenario,
    load_uncertainty,
    scenario_files,
)

OWN_LAW = Path(__file__).parents[3] / "examples" / "own_law.py"


def law(rod_extension, rod_reference, gain=1.3e5):
    return gain * (rod_reference[0] - rod_extension)


def with_factor(factor, offset=None):
    def scaled(rod_extension):
        return factor * rod_extension

    return scaled


def test_arguments_choose_inputs_and_gains() -> None:
    def stateful(knee_angle, time_s, knee_reference, state=(1.0, 2.0), k=3, tau=0.5):
        return 0.0, state

    arguments = Law(stateful).arguments
    assert arguments.inputs == ("knee_angle", "knee_reference")
    assert arguments.names == ("knee_angle", "time_s", "knee_reference", "state", "k", "tau")
    assert arguments.initial_state == (1.0, 2.0)
    assert arguments.gains == {"k": 3.0, "tau": 0.5}


class Object:
    def method(self, rod_extension):
        return rod_extension


def test_a_law_is_known_by_its_object() -> None:
    one, other = Object(), Object()
    assert Law(one.method) == Law(one.method)
    assert Law(one.method) != Law(other.method)
    assert Law(with_factor(1.0)) != Law(with_factor(1.0))
    assert Law(law) == Law(law)
    assert hash(Law(law)) == hash(Law(law))


def test_a_file_gives_the_law_and_later_changes_are_noticed(tmp_path: Path) -> None:
    file = tmp_path / "my laws.py"
    file.write_text("from other import K\ndef law(rod_extension):\n    return K * rod_extension\n")
    (tmp_path / "other.py").write_text("K = 4.0\n")
    loaded = Law.from_text("my laws.py:law", tmp_path)
    assert loaded.target(2.0) == 8.0
    assert loaded.name == f"{file}:law"
    again = Law.from_text(loaded.name)
    assert again == loaded
    file.write_text("def law(rod_extension):\n    return 5.0 * rod_extension\n")
    assert Law.from_text(loaded.name) != again
    assert Law.from_text(loaded.name).target(2.0) == 10.0


def test_a_changed_file_that_a_law_imports_is_imported_anew(tmp_path: Path) -> None:
    file, below, lowest = (tmp_path / name for name in ("my.py", "held_one.py", "held_two.py"))
    file.write_text("import held_one\ndef law(rod_extension):\n    return held_one.K\n")
    below.write_text("from held_two import K\n")
    lowest.write_text("K = 4.0\n")
    first = Law.from_text(f"{file}:law")
    assert Law.from_text(f"{file}:law").target is first.target
    lowest.write_text("K = 12.5\n")
    second = Law.from_text(f"{file}:law")
    assert (first.target(0.0), second.target(0.0)) == (4.0, 12.5)
    assert first != second


def test_each_law_has_the_modules_of_its_folder(tmp_path: Path) -> None:
    laws = []
    for gain in (1.0, 2.5, 3.0):
        folder = tmp_path / f"{gain}"
        folder.mkdir()
        (folder / "deep_gain.py").write_text(f"GAIN = {gain}\n")
        (folder / "gains.py").write_text("import json\nfrom deep_gain import GAIN as K\n")
        (folder / "my.py").write_text("import gains\ndef law(knee_angle): return gains.K\n")
        laws.append(Law.from_text("my.py:law", folder))
    assert [law.target(0.0) for law in laws] == [1.0, 2.5, 3.0]
    assert [pickle.loads(pickle.dumps(law)).target(0.0) for law in laws] == [1.0, 2.5, 3.0]
    assert list(laws[0].sources) == ["my.py", "gains.py", "deep_gain.py"]
    assert laws[0] != laws[1]


def test_a_law_survives_pickle_and_a_scenario_file(tmp_path: Path) -> None:
    scenario = Scenario().with_law(f"{OWN_LAW}:law", values={"gain": 9e4})
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    for name, content in scenario_files(scenario, "my.yaml").items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert load_scenario(tmp_path / "my.yaml") == scenario
    again = pickle.loads(pickle.dumps(Scenario().with_law(with_factor(3.0))))
    assert again.controller.function.target(2.0) == 6.0


def test_a_law_with_functions_that_pickle_refuses_is_sent_by_its_name(tmp_path: Path) -> None:
    file = tmp_path / "my.py"
    file.write_text(
        "from pydrake.math import max\ndef law(knee_angle): return max(knee_angle, 0)\n"
    )
    one = Law.from_text(f"{file}:law")
    assert pickle.loads(pickle.dumps(one)).target(2.0) == 2.0


def test_the_name_of_a_law_leads_to_the_law_or_is_refused() -> None:
    Law.from_text(f"{OWN_LAW}:law").require_name()
    Law(law).require_name()
    half = partial(law, gain=0.5)  # its name is that of the class partial
    for nameless in (Law(half), Law(with_factor(3.0))):
        with pytest.raises(ParameterError, match=r"^law .*: this name leads to no file with this"):
            nameless.require_name()


def test_a_relative_file_starts_at_the_scenario_file(tmp_path: Path) -> None:
    (tmp_path / "my.py").write_text("def law(rod_extension):\n    return 0.0\n")
    path = tmp_path / "my.yaml"
    path.write_text("controller: {kind: law, function: 'my.py:law'}\n")
    assert load_scenario(path).controller.function.name == f"{tmp_path / 'my.py'}:law"


MARKER = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n"


def write_marked(file: Path) -> None:
    file.parent.mkdir(exist_ok=True)
    file.write_text(MARKER + "def law(rod_extension, gain=1.0):\n    return gain * rod_extension\n")


def test_a_scenario_file_runs_its_law_at_the_first_use(tmp_path: Path) -> None:
    write_marked(tmp_path / "laws" / "my.py")
    path = tmp_path / "my.yaml"
    path.write_text("controller: {kind: law, function: 'laws/my.py:law'}\n")
    scenario = load_scenario(path)
    assert dump_scenario(scenario).count('function: "laws/my.py:law"') == 1
    assert scenario == load_scenario(path)
    assert scenario.changed({"controller.values.gain": 2.0}).controller.values == {"gain": 2.0}
    assert not (tmp_path / "laws" / "ran").exists()
    assert scenario.with_loaded_law().controller.values == {"gain": 1.0}
    assert (tmp_path / "laws" / "ran").exists()
    wrong = load_scenario(path).changed({"controller.values.gian": 2.0})
    with pytest.raises(ParameterError, match=r"^values.gian: law my.py:law has no argument"):
        wrong.with_loaded_law()


@pytest.mark.parametrize(
    "name",
    ["os:abort", "../my.py:law", "{}/my.py:law", "link.py:law", "links/my.py:law", "my.pyc:law"],
)
def test_a_scenario_file_names_no_code_elsewhere(name: str, tmp_path: Path, monkeypatch) -> None:
    write_marked(tmp_path / "my.py")
    folder = tmp_path / "downloaded"
    folder.mkdir()
    monkeypatch.chdir(folder)
    (folder / "link.py").symlink_to(tmp_path / "my.py")
    (folder / "links").symlink_to(tmp_path)
    path = folder / "my.yaml"
    text = json.dumps(name.format(tmp_path))
    path.write_text(f"controller: {{kind: law, function: {text}}}\n")
    with pytest.raises(ScenarioError, match=r"must be NAME.py:function, .* with --law$"):
        load_scenario(path)
    path.write_text(f"controller.function: {{options: [{text}]}}\n")
    with pytest.raises(ScenarioError, match=r"controller.function: must name no law"):
        load_uncertainty(path, Scenario().with_law(law))
    path.write_text(f"controller: {{options: [{{kind: law, function: {text}}}]}}\n")
    with pytest.raises(ScenarioError, match=r"controller: must name no law; vary its gains"):
        load_uncertainty(path)
    assert not (tmp_path / "ran").exists()


def test_files_of_a_law_do_not_replace_the_law(tmp_path: Path) -> None:
    write_marked(tmp_path / "source" / "my.py")
    scenario = Scenario().with_law(f"{tmp_path / 'source' / 'my.py'}:law")
    (tmp_path / "source" / "my.py").write_text("changed during the run")
    files = scenario_files(scenario, "s.yaml", tmp_path)
    assert files.keys() == {"my.py", "s.yaml"}
    assert scenario_files(scenario, "s.yaml", tmp_path / "source") == {"s.yaml": files["s.yaml"]}


def test_gains_are_reached_by_their_path() -> None:
    scenario = Scenario().with_law(law)
    assert scenario.controller.values == {"gain": 1.3e5}
    other = changed(scenario, {"controller.values.gain": 2e5})
    assert other.controller.values == {"gain": 2e5}
    assert scenario.controller.values == {"gain": 1.3e5}
    assert other != scenario


class Empty(LeafSystem):
    pass


class Hide:
    def __call__(self, rod_extension):
        return 0.0


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (Empty(), "Drake cannot clone this system; give its class"),
        (lambda: 1, "takes no argument and returns int"),
        (Hide, r"is a class, but no Drake system; give .* Hide\(\)"),
    ],
)
def test_what_makes_no_system_is_one_line(target, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        Law(target).make_system()


def test_a_drake_system_or_its_class_is_a_law() -> None:
    for target in (Empty, Empty(), lambda: Empty()):
        assert Law(target).is_system
    assert isinstance(Law(Empty).make_system(), Empty)
    assert not Law(law).is_system
    with pytest.raises(ParameterError, match="cannot be sent to worker processes"):
        pickle.dumps(Law(Empty()))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (3, "law = 3: must be a function, a Drake system, or"),
        ("my.py", "law 'my.py': must be FILE.py:NAME"),
        ("my.py:law:x", "law 'my.py:law:x': must be FILE.py:NAME"),
        (f"{OWN_LAW}:zzz", "has no 'zzz'; did you mean law?"),
        ("my.py:law", "law 'my.py:law': there is no file "),
        (f"{OWN_LAW}:low", "has no 'low'; did you mean law?"),
        ("no_such_module:law", "no module named 'no_such_module'"),
        (lambda rod_extention: 1.0, "did you mean rod_extension?"),
        (lambda rod_extension, gain="2": 1.0, "unknown argument 'gain'"),
        (lambda rod_extension, _m=1.0: 1.0, "the argument '_m' has a name that kneexo uses"),
        (lambda rod_extension, initial_state_0=1.0: 1.0, "rename the argument"),
        (lambda rod_extension, command_limit_rad_s=1.0: 1.0, "rename the argument"),
        (lambda rod_extension, state: 1.0, "initial_state is missing, such as [0.0]"),
        (lambda scenario, state=(0.0,): 1.0, "has the arguments scenario and state; a function of"),
        (lambda rod_extension, gain=math.nan: 1.0, "the default gain = nan must be finite; give"),
        (lambda rod_extension, gain=10**400: 1.0, "the default of gain must be numbers: Overflow"),
        (lambda rod_extension, state=(1.0, -math.inf): 1.0, "the default state = -inf must be"),
    ],
)
def test_a_wrong_law_is_one_line(bad, message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        Scenario().with_law(bad)
    text = str(caught.value)
    assert message in text
    assert "\n" not in text
    assert "LawParameters" not in text


def test_a_template_of_drake_is_its_class_for_floats() -> None:
    law = Law(FunctionLaw_)
    assert law.is_system
    assert law.target is FunctionLaw_[float]


def test_a_single_number_is_an_initial_state() -> None:
    scenario = Scenario().with_law(lambda rod_extension, state=0.5: (0.0, state))
    assert scenario.controller.initial_state == (0.5,)
    scenario = Scenario().with_law(lambda rod_extension, state: (0.0, state), initial_state=2.0)
    assert scenario.controller.initial_state == (2.0,)


def test_a_file_that_fails_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "my.py"
    file.write_text("x = 1\n1 / 0\n")
    with pytest.raises(ParameterError, match=r"the file fails: ZeroDivisionError.*my.py, line 2"):
        Law.from_text(f"{file}:law")
    file.write_text(f"from kneexo.parameters import Law\nLaw.from_text({str(file) + ':law'!r})\n")
    with pytest.raises(ParameterError, match="put the lines that use the law below `if __name__"):
        Law.from_text(f"{file}:law")


def test_values_and_states_must_suit_the_function() -> None:
    with pytest.raises(ParameterError, match=r"has no argument of this name .* known: gain"):
        LawParameters(function=law, values={"gian": 1.0})
    with pytest.raises(ParameterError, match=r"values.gain.* finite"):
        LawParameters(function=law, values={"gain": math.nan})
    with pytest.raises(ParameterError, match="has no argument state"):
        LawParameters(function=law, initial_state=[0.0])
    with pytest.raises(ParameterError, match="is a Drake system: initial_state and values must"):
        LawParameters(function=LeafSystem, values={"gain": 1.0})


def test_a_function_of_a_scenario_has_gains_and_makes_a_system() -> None:
    def make(scenario, gain=2.0):
        return Gain(gain * scenario.initial_offset_m, 1)

    law = Law(make)
    assert law.is_system
    assert law.takes_scenario
    assert law.arguments.gains == {"gain": 2.0}
    system = law.make_system({"scenario": Scenario(initial_offset_m=0.1), "gain": 3.0})
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, [10.0])
    assert system.get_output_port().Eval(context)[0] == pytest.approx(3.0)
    scenario = Scenario().with_law(make, values={"gain": 4.0})
    assert scenario.controller.values == {"gain": 4.0}
    with pytest.raises(ParameterError, match=r"values.k: law .* has no argument of this name"):
        Scenario().with_law(make, values={"k": 4.0})


def test_numbers_of_numpy_are_gains_and_others_are_one_line() -> None:
    def law(rod_extension, a=np.float32(0.5), b=np.int64(3), c=Fraction(1, 4)):
        return 0.0

    assert Law(law).arguments.gains == {"a": 0.5, "b": 3.0, "c": 0.25}


class Anything:
    """An object that has every attribute."""

    def __getattr__(self, name):
        return self

    def __call__(self, *arguments):
        return self


def test_an_object_that_has_every_attribute_is_one_line() -> None:
    law = Law(Anything())
    assert law.name.endswith(":Anything")
    with pytest.raises(ParameterError, match="Anything: has no readable arguments: TypeError: "):
        _ = law.is_system
