"""A diagram as FMU in one call: its file, its variables, its binaries on other platforms."""

import math
import struct
import zipfile
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from pydrake.examples import PendulumPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, Integrator

from diagramc import FmuParameter, Interface, export_fmu, write_fmu
from diagramc.c import build, cross
from diagramc.c.cross import PLATFORMS
from diagramc.errors import CompilationError, OutputError

TICK_S, STEPS = 0.01, 200
START = (1.0, 0.0)
"""Initial angle and rate of the pendulum."""


@pytest.fixture
def no_compiler(monkeypatch):
    """There is no C compiler, so the FMU has sources alone."""
    monkeypatch.setattr(build, "COMPILERS", ())


def _pendulum(directory, **options):
    options = {"name": "pendulum", "inputs": ["tau"], "tick_s": TICK_S} | options
    return export_fmu(PendulumPlant(), directory, **options)


def _drakes_pendulum():
    """A pendulum in Drake's Simulator with a small error, and its Context."""
    simulator = Simulator(PendulumPlant())
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    context = simulator.get_mutable_context()
    context.SetContinuousState(START)
    return simulator, context


@pytest.mark.parametrize("version", [2, 3])
def test_a_diagram_follows_drake(version, tmp_path, fmu_instance):
    """Drake's RK3 with the tolerance 1e-10 against RK4 with 0.2 ms: both to 1e-9 here."""
    interface = Interface({"state": ["theta_rad", "rate_rad_s"], "tau": ["torque_n_m"]})
    file = _pendulum(tmp_path / "new" / "a b", version=version, interface=interface)
    if not file.platforms:
        pytest.skip("needs a C compiler on Linux in 64 bits")
    assert file.path == str(tmp_path / "new" / "a b" / "pendulum.fmu")
    assert (file.inputs, file.outputs) == (("torque_n_m",), ("theta_rad", "rate_rad_s"))
    assert file.parameters == (
        *(f"pendulum.{name}" for name in ("mass", "length", "damping", "gravity")),
        *("initial.pendulum.theta", "initial.pendulum.thetadot"),
    )
    assert file.sample_time_s == TICK_S
    fmu = fmu_instance(file.path)
    fmu.start(**{"initial.pendulum.theta": START[0], "pendulum.mass": 2.0, "torque_n_m": 0.5})

    simulator, context = _drakes_pendulum()
    context.get_mutable_numeric_parameter(0).set_mass(2.0)
    simulator.get_system().get_input_port().FixValue(context, [0.5])
    for n in range(STEPS):
        fmu.step(n * TICK_S, TICK_S)
        simulator.AdvanceTo((n + 1) * TICK_S)
        expected = context.get_continuous_state_vector().CopyToVector()
        assert fmu.get("theta_rad", "rate_rad_s") == pytest.approx(expected, abs=1e-8)


def test_context_and_start_values(tmp_path, no_compiler):
    context = PendulumPlant().CreateDefaultContext()
    context.SetContinuousState([0.25, 0.0])
    options = {
        "context": context,
        "starts": {"tau": 0.5},
        "stop_s": 3.0,
        "description": 'a "b" <c>',
    }
    file = _pendulum(tmp_path, parameters=["initial.pendulum.theta"], **options)
    assert file.platforms == ()
    assert file.parameters == ("initial.pendulum.theta",)
    with zipfile.ZipFile(file.path) as archive:
        text = archive.read("modelDescription.xml").decode()
    assert 'stopTime="3.0"' in text
    assert 'description="a &quot;b&quot; &lt;c&gt;"' in text
    assert 'start="0.25"' in text
    assert 'start="0.5"' in text


def test_control_characters_in_names_are_escaped(tmp_path, no_compiler):
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    builder = DiagramBuilder()
    sum_ = builder.AddNamedSystem("a\x01\x1f\nb é", Integrator(1))
    gain = builder.AddNamedSystem("of\ttwo", Gain(2.0, 1))
    builder.Connect(sum_.get_output_port(), gain.get_input_port())
    builder.ExportInput(sum_.get_input_port(), "u")
    builder.ExportOutput(gain.get_output_port(), "y\x02")
    options = {"name": "sum", "inputs": ["u"], "tick_s": TICK_S, "description": "bell: \a\ud800"}
    file = export_fmu(builder.Build(), tmp_path, **options)
    description = fmpy.read_model_description(file.path)  # validates
    assert description.description == r"bell: \x07\ud800"
    by_name = {variable.name: variable for variable in description.modelVariables}
    (initial,) = (name for name in by_name if name.startswith("initial."))
    assert by_name[initial].description == r"start value of the state a\x01\x1f\nb é.x[0]"


def _one_line(error):
    return str(error.value).isprintable()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "a\nb"}, r"name = 'a\nb': must be a C identifier"),
        ({"name": "FMI3"}, "name = 'FMI3': is a prefix of FMI; choose another name"),
        ({"name": "fmi2", "version": 2}, "name = 'fmi2': is a prefix of FMI; choose another name"),
        ({"version": 1}, "version = 1: must be one of 2, 3"),
        ({"version": "3"}, "version = '3': must be one of 2, 3"),
        ({"inputs": ["torque"]}, "has no input port 'torque'; it has tau"),
        ({"tick_s": None}, "pendulum: tick_s is needed, for it has no sample time"),
        ({"tick_s": math.nan}, "tick_s = nan s: must be finite and > 0"),
        (
            {"platforms": ["win64"]},
            "platforms: 'win64' is unknown; must be all, or of x86_64-linux",
        ),
        ({"starts": {"theta": 1.0}}, "starts: 'theta' is no input; inputs: tau"),
        ({"starts": {"tau": math.nan}}, "tau = nan: must be finite at the start"),
        ({"parameters": ["mass"]}, "parameter 'mass': is unknown; known: pendulum.mass, "),
        (
            {"parameters": [FmuParameter("my mass", 1.0, ("pendulum.mass",))]},
            "parameter 'my mass': must be a name such as leaf.mass or gains[2]",
        ),
        (
            {"parameters": [FmuParameter("m", 1.0, ("pendulum.mass",), low=2.0, high=3.0)]},
            "m = 1: must be 2 … 3",
        ),
        ({"parameters": [FmuParameter("m", math.nan, ("pendulum.mass",))]}, "m = nan: must be "),
        ({"stop_s": math.inf}, "stop_s = inf s: must be finite and > 0 s"),
        ({"stop_s": "a"}, "stop_s = 'a': must be finite and > 0 s"),
        ({"platforms": 3}, "platforms = 3: must be all, or names of platforms"),
        ({"parameters": 3}, "parameters = 3: must be a list of names or of FmuParameter"),
        ({"parameters": [3]}, "an element of parameters = 3: must be a name or an FmuParameter"),
        ({"parameters": [FmuParameter("m", "a", ())]}, "start of 'm' = 'a': must be a number"),
        ({"parameters": [FmuParameter("m", 1.0, None)]}, "members of 'm' = None: must be a tuple"),
        (
            {"parameters": [FmuParameter("m", 1.0, ("pendulum.mass",), divisor=0.0)]},
            "divisor of 'm' = 0: must be finite, and not 0",
        ),
        (
            {"parameters": [FmuParameter("m", 1.0, ("pendulum.mass",), description=3)]},
            "description of 'm' = 3: must be a text",
        ),
        ({"description": 3}, "description = 3: must be a text"),
        ({"starts": {"tau": "a"}}, "start value tau = 'a': must be a finite number"),
        ({"starts": 3}, "starts = 3: must be a dictionary"),
        ({"nope": 1}, "option 'nope': is unknown; known: "),
    ],
)
def test_wrong_arguments_are_one_line(options, message, tmp_path, no_compiler):
    with pytest.raises(CompilationError) as error:
        _pendulum(tmp_path / "new", **options)
    assert message in str(error.value)
    assert _one_line(error)
    assert not (tmp_path / "new").exists()


def test_an_earlier_export_is_replaced(tmp_path, no_compiler):
    first = Path(_pendulum(tmp_path).path).read_bytes()
    second = Path(_pendulum(tmp_path, version=2).path).read_bytes()
    assert first != second
    other = _pendulum(tmp_path, name="other")  # two FMUs may share a directory
    assert sorted(tmp_path.iterdir()) == [Path(other.path), tmp_path / "pendulum.fmu"]
    assert Path(_pendulum(tmp_path).path).read_bytes() == first


@pytest.mark.parametrize("place", ["file/inner", "x" * 256])
def test_a_place_that_cannot_be_written(place, tmp_path, no_compiler):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError) as error:
        _pendulum(tmp_path / place)
    assert _one_line(error)
    assert str(error.value).startswith("file ")
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_a_failed_compiler_leaves_the_earlier_file(fmu, tmp_path, monkeypatch):
    file = tmp_path / "lag.fmu"
    monkeypatch.setattr(build, "COMPILERS", ())
    write_fmu(file, replace(fmu, description="first"))
    before = file.read_bytes()
    compiler = tmp_path / "bin" / "compiler"
    compiler.parent.mkdir()
    compiler.write_text("#!/bin/sh\nexit 1\n")
    compiler.chmod(0o755)
    with monkeypatch.context() as patch:
        patch.setattr(build, "COMPILERS", (str(compiler),))
        patch.setattr(cross, "native_platform", lambda: "x86_64-linux")
        with pytest.raises(CompilationError, match=r"^compiler: no message$"):
            write_fmu(file, replace(fmu, description="second"))
    assert file.read_bytes() == before


# ------------------------------------------------------------------------------- platforms


MAGIC = {
    "x86_64-linux": (b"\x7fELF", 18, "<H", 62),
    "aarch64-linux": (b"\x7fELF", 18, "<H", 183),
    "x86_64-windows": (b"MZ", None, "<H", 0x8664),
    "x86_64-darwin": (b"\xcf\xfa\xed\xfe", 4, "<I", 0x01000007),
    "aarch64-darwin": (b"\xcf\xfa\xed\xfe", 4, "<I", 0x0100000C),
}
"""First bytes of a library, place and format of the number of its processor, and this number.

In a file for Windows, the number is 4 bytes after the place that the word at byte 60 tells.
"""


def _swinging(folder, version, platforms="all"):
    context = PendulumPlant().CreateDefaultContext()
    context.SetContinuousState(START)
    options = {"context": context, "stop_s": STEPS * TICK_S, "platforms": platforms}
    return _pendulum(folder, version=version, **options)


@pytest.fixture(scope="module", params=[2, 3])
def everywhere(request, tmp_path_factory):
    """File of the pendulum with a binary for each platform, and the version; skips without Zig."""
    if find_spec("ziglang") is None:
        pytest.skip("needs Zig: pip install ziglang")
    folder = tmp_path_factory.mktemp("every platform")
    file = _swinging(folder, request.param)
    assert file.platforms == tuple(PLATFORMS)
    return file, request.param


def _binaries(file):
    """The binaries of an FMU by the ends of their names."""
    with zipfile.ZipFile(file) as archive:
        names = [name for name in archive.namelist() if name.startswith("binaries/")]
        return {name: archive.read(name) for name in names}


def _folder(platform, version):
    names = {"x86_64-linux": "linux64", "x86_64-windows": "win64", "x86_64-darwin": "darwin64"}
    return names.get(platform, platform) if version == 2 else platform


@pytest.mark.slow(gate=0)
def test_each_binary_is_of_its_platform(everywhere):
    file, version = everywhere
    binaries = _binaries(file.path)
    assert len(binaries) == len(PLATFORMS)
    for platform, (magic, place, form, processor) in MAGIC.items():
        name = f"binaries/{_folder(platform, version)}/pendulum{PLATFORMS[platform].suffix}"
        data = binaries[name]
        assert data.startswith(magic)
        place = struct.unpack_from("<I", data, 60)[0] + 4 if place is None else place
        assert struct.unpack_from(form, data, place) == (processor,)
        assert f"fmi{version}DoStep".encode() in data
        # Apple silicon loads no library without a signature, which has this magic number.
        assert platform != "aarch64-darwin" or b"\xfa\xde\x0c\xc0" in data
        # Other functions are hidden; files for macOS have the names of hidden functions, too.
        assert platform.endswith("darwin") or b"pendulum_fmu_step" not in data


@pytest.mark.slow(gate=0)
def test_the_archive_of_all_platforms_is_valid_and_the_same_each_time(everywhere, tmp_path):
    file, version = everywhere
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    from fmpy.validation import validate_fmu

    assert validate_fmu(file.path) == []
    native = _swinging(tmp_path, version, None)
    if native.platforms == ("x86_64-linux",):
        runs = [fmpy.simulate_fmu(fmu.path, output_interval=TICK_S) for fmu in (file, native)]
        assert len(runs[0]) == STEPS + 1
        for name in ("state_0", "state_1"):
            assert np.abs(runs[0][name] - runs[1][name]).max() < 1e-12
    again = _swinging(tmp_path, version)
    assert Path(again.path).read_bytes() == Path(file.path).read_bytes()


@pytest.mark.slow(gate=0)
@pytest.mark.parametrize("platform", ["x86_64-linux", "aarch64-linux", "x86_64-windows"])
def test_each_platform_follows_drake(platform, everywhere, run_elsewhere):
    """Tolerance: 1e-8 as in `test_a_diagram_follows_drake`. The platforms agree to 1e-12."""
    rows = run_elsewhere(everywhere[0].path, platform, STEPS, TICK_S)
    simulator, context = _drakes_pendulum()
    port = simulator.get_system().get_input_port()
    expected = []
    for n in range(STEPS):
        port.FixValue(context, [((7 * n + 3) % 17 - 8) / 64])  # as driver.c
        simulator.AdvanceTo((n + 1) * TICK_S)
        expected.append(context.get_continuous_state_vector().CopyToVector())
    assert np.abs(rows - expected).max() < 1e-8
    native = run_elsewhere(everywhere[0].path, "x86_64-linux", STEPS, TICK_S)
    assert np.abs(rows - native).max() < 1e-12
