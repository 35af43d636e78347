"""FMUs of small diagrams whose answers are known in closed form."""

import io
import math
import shutil
import subprocess
import sys
import zipfile
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.primitives import Sine

import diagramc
from diagramc import read_diagram, write_fmu
from diagramc.c import build as c_build
from diagramc.c.source import source_of
from diagramc.errors import CompilationError
from diagramc.fmu.fmu import Fmu
from diagramc.fmu.variables import FmuParameter

TICK_S, RATE_PER_S = 0.1, 2.0
"""Those of the model of `lag_source`."""
NEEDS_COMPILER = pytest.mark.skipif(
    not any(map(shutil.which, c_build.COMPILERS)), reason="needs a C compiler"
)


@pytest.fixture
def lag(path, fmu_instance):
    return fmu_instance(path).start()


def _exact(time, start, u):
    final = 3.0 * u / RATE_PER_S
    return final + (start - final) * math.exp(-RATE_PER_S * time)


def test_follows_the_closed_form(lag):
    """Each step holds its input; RK4 with 0.2 ms is exact to 1e-13 here."""
    expected, late = 0.5, 0.0
    for n, u in enumerate([0.25, 1.0, -2.0, 0.0]):
        lag.set(u_m_s=u)
        lag.step(n * TICK_S, TICK_S)
        # The delay line holds the x at the begin of the last step but one.
        before, expected = expected, _exact(TICK_S, expected, u)
        assert lag.get("x_m") == pytest.approx(expected, abs=1e-12)
        assert lag.get("late_m") == pytest.approx(late, abs=1e-12)
        assert lag.get("d_m_s") == pytest.approx(3.0 * u, abs=0.0)
        assert lag.get("time") == pytest.approx((n + 1) * TICK_S, abs=1e-15)
        late = before


def test_values_while_initializing(path, fmu_instance):
    lag = fmu_instance(path)
    assert "x_m: has no value before initialization" in lag.refusal(lag.get, "x_m")
    assert lag.get("sample_time_s", "u_m_s", "initial.x_mm") == [TICK_S, 0.25, 500.0]
    lag.enter()
    assert lag.get("x_m", "d_m_s") == [0.5, 0.75]
    lag.set({"initial.x_mm": 125.0, "u_m_s": -1.0})
    assert lag.get("x_m", "d_m_s") == [0.125, -3.0]
    lag.fmu.exitInitializationMode()
    assert lag.get("x_m", "d_m_s", "time") == [0.125, -3.0, 0.0]


def test_a_step_of_many_ticks_equals_that_many_steps(path, fmu_instance):
    single, many = fmu_instance(path).start(), fmu_instance(path).start()
    single.step(0.0, 7 * TICK_S)
    for n in range(7):
        many.step(n * TICK_S, TICK_S)
    assert single.get("x_m", "late_m", "time") == many.get("x_m", "late_m", "time")


def test_times_count_from_the_start_time(path, fmu_instance):
    shifted, plain = fmu_instance(path).start(start=12.345), fmu_instance(path).start()
    assert shifted.get("time") == 12.345
    for n in range(3):
        shifted.step(12.345 + n * TICK_S, TICK_S)
        plain.step(n * TICK_S, TICK_S)
    assert shifted.get("x_m") == plain.get("x_m")
    assert shifted.get("time") == pytest.approx(12.645, abs=1e-12)


def test_summed_times_do_not_matter(lag):
    time = 0.0
    for _ in range(20_000):  # the sum is off by 3e-9 s in the end
        lag.step(time, TICK_S)
        time += TICK_S
    assert time != 20_000 * TICK_S
    assert lag.get("time") == pytest.approx(2000.0, abs=1e-12)


@pytest.mark.parametrize(
    ("time", "size", "message"),
    [
        (
            0.0,
            0.15,
            "communication step = 0.15 s: must be a whole multiple of the sample time = 0.1 s",
        ),
        (0.0, 0.1001, "must be a whole multiple"),
        (0.0, 0.0, "must be a whole multiple"),
        (0.0, -0.1, "must be a whole multiple"),
        (0.0, math.nan, "must be a whole multiple"),
        (0.1, 0.1, "communication point = 0.1 s: must be the end of the last step, t = 0 s"),
        (0.05, 0.1, "must be the end of the last step"),
        (math.nan, 0.1, "must be the end of the last step"),
        (0.0, math.inf, "must be a whole multiple"),
        (0.0, 5e8, "must be less than 2^32 sample times"),
    ],
)
def test_steps_off_the_grid_are_refused(lag, time, size, message):
    assert message in lag.refusal(lag.step, time, size)
    lag.step(0.0, TICK_S)  # nothing has changed
    assert lag.get("x_m") == pytest.approx(_exact(TICK_S, 0.5, 0.25), abs=1e-12)


def test_fmpy_keeps_to_the_grid(path):
    """An importer may end steps where an input jumps, unless the FMU says that it cannot."""
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")

    names = [("time", float), ("u_m_s", float)]
    jump = 2.5 * TICK_S
    signal = np.array([(0.0, 0.0), (jump, 0.0), (jump, 1.0), (5 * TICK_S, 1.0)], dtype=names)
    run = fmpy.simulate_fmu(
        str(path), stop_time=5 * TICK_S, output_interval=TICK_S, input=signal, output=["x_m"]
    )
    expected = [0.5]
    for n in range(5):
        expected.append(_exact(TICK_S, expected[-1], float(n * TICK_S > jump)))
    assert run["time"] == pytest.approx(TICK_S * np.arange(6), abs=1e-12)
    assert run["x_m"] == pytest.approx(expected, abs=1e-12)


def test_no_step_beyond_the_stop_time(path, fmu_instance):
    lag = fmu_instance(path).start(stop=0.3)
    lag.step(0.0, 0.2)
    assert "must not be after the stop time = 0.3 s" in lag.refusal(lag.step, 0.2, 0.2)
    lag.step(0.2, TICK_S)
    other = fmu_instance(path)
    refusal = other.refusal(other.enter, start=1.0, stop=0.5)
    assert "start time = 1 s: must be finite, and not after stop time = 0.5 s" in refusal


def test_a_tuned_parameter_acts_from_the_next_step_on(path, fmu_instance):
    lag = fmu_instance(path).start(offset_m_s=1.0)
    lag.step(0.0, TICK_S)
    first = _exact(TICK_S, 0.5, 1.25)
    assert lag.get("x_m") == pytest.approx(first, abs=1e-12)
    lag.set(offset_m_s=-2.0)
    assert lag.get("x_m", "d_m_s") == [pytest.approx(first, abs=1e-12), 3.75]
    for n in (1, 2):
        lag.step(n * TICK_S, TICK_S)
    assert lag.get("x_m") == pytest.approx(_exact(0.2, first, -1.75), abs=1e-12)
    assert lag.get("d_m_s") == -5.25
    message = lag.refusal(lag.set, offset_m_s=math.inf)
    assert message == "offset_m_s = inf m/s: must be finite"


def test_start_and_stop_time_may_be_left_out(path, fmu_instance):
    lag = fmu_instance(path)
    if lag.two:  # where telling them is a call of its own
        lag.fmu.enterInitializationMode()
        lag.fmu.exitInitializationMode()
    else:
        lag.start()
    lag.step(0.0, 100 * TICK_S)
    assert lag.get("time") == pytest.approx(10.0)


def test_an_input_that_is_not_finite_is_explained(lag):
    lag.step(0.0, TICK_S)
    before = lag.get("x_m")
    lag.set(u_m_s=math.nan)
    message = lag.refusal(lag.step, TICK_S, TICK_S)
    assert message == (
        "t = 0.1 s: the step failed, status = 1: an input is not finite or out of its range, "
        "u_m_s = nan m/s"
    )
    assert lag.get("x_m", "time") == [before, TICK_S]
    lag.set(u_m_s=0.0)
    lag.step(TICK_S, TICK_S)
    assert lag.get("x_m") == pytest.approx(_exact(TICK_S, before, 0.0), abs=1e-12)


def test_a_result_that_is_not_finite_is_explained(lag):
    lag.set(u_m_s=1.7e308)
    message = lag.refusal(lag.step, 0.0, TICK_S)
    assert "status = 2: a result is not finite; check parameters and inputs" in message


@pytest.fixture(params=[2, 3])
def sensitive(request, tmp_path, fmu_instance, lag_source):
    """Its parameter is turned into another unit in C, where a large one overflows."""
    members = (
        ("offset_per_mm", "offset.group_0[0]", True),
        ("start_per_mm", "initial_x[0]", False),
    )
    parameters = [
        FmuParameter(name, 0.0, (member,), divisor=1e-3, tunable=tunable)
        for name, member, tunable in members
    ]
    fmu = Fmu(lag_source(), parameters, request.param)
    file = tmp_path / "lag.fmu"
    if not write_fmu(file, fmu).platforms:
        pytest.skip("needs a C compiler on Linux in 64 bits")
    return fmu_instance(str(file))


@pytest.mark.parametrize("name", ["offset_per_mm", "start_per_mm"])
def test_a_parameter_that_is_not_finite_in_c_is_explained(sensitive, name):
    sensitive.enter()
    sensitive.set({name: 1e307})
    message = sensitive.refusal(sensitive.fmu.exitInitializationMode)
    assert message == (
        "t = 0 s: the initialization failed, status = 16: a parameter or start value of the model "
        "is not finite"
    )
    sensitive.set({name: 1e-3})
    sensitive.fmu.exitInitializationMode()
    assert sensitive.get("x_m") == (1.0 if name == "start_per_mm" else 0.0)


def test_a_tuned_parameter_that_is_not_finite_in_c_is_explained(sensitive):
    sensitive.start()
    sensitive.set(offset_per_mm=1e307)
    message = sensitive.refusal(sensitive.step, 0.0, TICK_S)
    assert message.startswith("t = 0 s: the change of parameters failed, status = 16: a parameter ")


def test_a_state_that_was_never_started_is_explained(lag):
    """Of damaged bytes: of the ones in it, one says that the model is started."""
    data, messages = lag.serialize(), []
    started = (1).to_bytes(4, sys.byteorder)
    for place in range(len(data) - 3):
        if data[place : place + 4] == started:
            lag.deserialize(data[:place] + bytes(4) + data[place + 4 :])
            before = len(lag.messages)
            with suppress(Exception):
                lag.step(0.0, TICK_S)
            messages += lag.messages[before:]
    assert (
        "t = 0 s: the step failed, status = 8: the model is not started; initialize the instance "
        "again"
    ) in messages


def test_what_may_not_be_set(lag, path, fmu_instance):
    assert "x_m: is computed, and cannot be set" in lag.refusal(lag.set, x_m=1.0)
    assert "time: is computed" in lag.refusal(lag.set, time=1.0)
    assert "sample_time_s: is computed" in lag.refusal(lag.set, sample_time_s=1.0)
    fixed = {"initial.x_mm": 1.0}
    assert "initial.x_mm: is fixed once" in lag.refusal(lag.set, fixed)
    lag.references["none"] = 8  # there are 8 variables
    assert "value reference = 8: no Float64 has it" in lag.refusal(lag.set, none=1.0)
    assert "value reference = 8: no Float64 has it" in lag.refusal(lag.get, "none")
    other = fmu_instance(path)
    for value in (2000.1, -0.1, math.nan):
        message = other.refusal(other.set, {"u_m_s": 9.0, "initial.x_mm": value})
        expected = f"initial.x_mm = {value}: must be finite, lowest = 0, highest = 2000"
        assert message == expected
    assert other.get("u_m_s") == 0.25  # all or none


def test_calls_out_of_order_are_refused(path, fmu_instance):
    lag = fmu_instance(path)
    expected = "step: the instance must be initialized; it is instantiated"
    assert expected in lag.refusal(lag.step, 0.0, TICK_S)
    assert "must be in initialization" in lag.refusal(lag.fmu.exitInitializationMode)
    lag.start()
    assert "it is initialized" in lag.refusal(lag.enter)
    lag.fmu.terminate()
    assert "it is terminated" in lag.refusal(lag.step, 0.0, TICK_S)
    assert "u_m_s: cannot be set after the end" in lag.refusal(lag.set, u_m_s=1.0)
    assert lag.get("x_m") == 0.5


def test_a_wrong_token_is_refused(path, fmu_instance, capfd):
    with pytest.raises(Exception, match="Failed to instantiate"):
        fmu_instance(path, guid="of another")


def test_reset_forgets_all(lag):
    lag.set(u_m_s=5.0)
    lag.step(0.0, TICK_S)
    lag.fmu.reset()
    lag.start()
    assert lag.get("u_m_s", "x_m", "time") == [0.25, 0.5, 0.0]


def test_saved_states_continue_to_the_bit(path, fmu_instance):
    lag = fmu_instance(path).start()
    lag.step(0.0, 3 * TICK_S)
    saved, data = lag.save(), lag.serialize()
    lag.set(u_m_s=3.0)
    lag.step(0.3, TICK_S)
    expected = lag.get("x_m", "late_m", "time")
    lag.step(0.4, TICK_S)
    lag.restore(saved)
    assert lag.get("u_m_s", "time") == [0.25, pytest.approx(0.3)]
    lag.set(u_m_s=3.0)
    lag.step(0.3, TICK_S)
    assert lag.get("x_m", "late_m", "time") == expected

    other = fmu_instance(path)  # not even initialized
    other.deserialize(data)
    other.set(u_m_s=3.0)
    other.step(0.3, TICK_S)
    assert other.get("x_m", "late_m", "time") == expected


def test_bytes_of_another_fmu_are_refused(path, fmu_instance):
    lag = fmu_instance(path).start()
    data = bytearray(lag.serialize())
    data[0] ^= 1
    assert "is of another FMU" in lag.refusal(lag.deserialize, bytes(data))
    assert "must be that of this FMU" in lag.refusal(lag.deserialize, bytes(data[:-1]))


def test_instances_are_independent(path, fmu_instance):
    first, second = fmu_instance(path, name="a").start(), fmu_instance(path, name="b")
    second.start(**{"initial.x_mm": 0.0})
    first.set(u_m_s=1.0)
    for n in range(3):
        first.step(n * TICK_S, TICK_S)
        second.step(n * TICK_S, TICK_S)
    assert first.get("x_m") == pytest.approx(_exact(0.3, 0.5, 1.0), abs=1e-12)
    assert second.get("x_m") == pytest.approx(_exact(0.3, 0.0, 0.25), abs=1e-12)


def test_what_is_not_offered_is_refused(lag):
    fmu = lag.fmu
    if lag.two:
        assert "Real variables only" in lag.refusal(fmu.getInteger, [0])
        assert "Real variables only" in lag.refusal(fmu.getBoolean, [0])
        fmu.getInteger([])
    else:
        assert "Float64 variables only" in lag.refusal(fmu.getInt32, [0])
        assert "Float64 variables only" in lag.refusal(fmu.getBoolean, [0])
        fmu.getInt32([])
        assert "no event mode" in lag.refusal(fmu.enterEventMode)


# --------------------------------------------------------------------------------- sources


def _clock(fmi):
    """Without inputs, parameters and states: sin(3 t)."""
    sine = Sine(amplitude=1.0, frequency=3.0, phase=0.0, size=1)
    sine.set_name('clock % "é"')
    return Fmu(source_of(read_diagram(sine), "clock", tick_s=TICK_S, outputs=["y0"]), fmi=fmi)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_model_of_the_time_alone(fmi, fmu_instance, tmp_path):
    fmu = _clock(fmi)
    if not write_fmu(tmp_path / "clock.fmu", fmu).platforms:
        pytest.skip("needs a C compiler on Linux in 64 bits")
    clock = fmu_instance(tmp_path / "clock.fmu").start(start=1.0)
    assert clock.get("y0") == 0.0
    clock.step(1.0, 2 * TICK_S)
    assert clock.get("y0") == pytest.approx(math.sin(0.6), rel=1e-15)
    test_sources_compile_without_a_warning(fmu, "gcc", tmp_path)


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_sources_compile_without_a_warning(fmu, compiler, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"needs {compiler}")
    for name, text in fmu.sources.items():
        (tmp_path / name).write_text(text)
    flags = "-std=c99 -O2 -Wall -Wextra -Wconversion -Wpedantic -Wshadow -Werror -c"
    files = sorted(name for name in fmu.sources if name.endswith(".c"))
    command = [compiler, *flags.split(" "), *files]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert all(text.isascii() for text in fmu.sources.values())


@NEEDS_COMPILER
@pytest.mark.parametrize("name", ["write", "instance"])
def test_names_of_models_clash_with_no_function(name, fmu, tmp_path):
    renamed = replace(fmu, source=replace(fmu.source, name=name))
    for file, text in renamed.sources.items():
        (tmp_path / file).write_text(text)
    compiler = next(filter(None, map(shutil.which, c_build.COMPILERS)))
    files = sorted(file for file in renamed.sources if file.endswith(".c"))
    command = [compiler, "-std=c99", "-fsyntax-only", *files]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_library_shows_the_functions_of_the_standard_alone(fmu, path, tmp_path):
    if shutil.which("nm") is None:
        pytest.skip("needs nm")
    with zipfile.ZipFile(path) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".so"))
        (tmp_path / "lag.so").write_bytes(archive.read(name))
    command = ["nm", "-D", "--defined-only", tmp_path / "lag.so"]
    table = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    names = {line.split()[-1] for line in table.splitlines()}
    assert all(name.startswith(f"fmi{fmu.fmi}") for name in names)
    assert {f"fmi{fmu.fmi}DoStep", f"fmi{fmu.fmi}GetVersion"} <= names


@NEEDS_COMPILER
def test_functions_take_a_prefix(fmu, tmp_path):
    if shutil.which("nm") is None:
        pytest.skip("needs nm")
    for name, text in fmu.sources.items():
        (tmp_path / name).write_text(text)
    compiler = next(filter(None, map(shutil.which, c_build.COMPILERS)))
    prefix = f"-DFMI{fmu.fmi}_FUNCTION_PREFIX=lag_"
    file = f"lag_fmi{fmu.fmi}.c"
    subprocess.run([compiler, "-std=c99", prefix, "-c", file], cwd=tmp_path, check=True)
    command = ["nm", "-g", "--defined-only", file.replace(".c", ".o")]
    table = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    names = {line.split()[-1] for line in table.splitlines()}
    assert names
    assert all(name.startswith(f"lag_fmi{fmu.fmi}") for name in names)


FOLDERS = {
    "x86_64-linux": ("linux64", "lag.so"),
    "aarch64-linux": ("aarch64-linux", "lag.so"),
    "x86_64-windows": ("win64", "lag.dll"),
    "x86_64-darwin": ("darwin64", "lag.dylib"),
    "aarch64-darwin": ("aarch64-darwin", "lag.dylib"),
}
"""For each platform its folder by FMI 2.0.4, section 2.3, and the name of the file in it."""


def test_archive(fmu):
    libraries = {platform: platform.encode() for platform in FOLDERS}
    archive = fmu.archive(libraries)
    other_order = dict(reversed(libraries.items()))
    assert archive == replace(fmu).archive(other_order)  # no dates, no order of dictionaries
    binaries = {
        f"binaries/{folder if fmu.fmi == 2 else platform}/{file}": platform.encode()
        for platform, (folder, file) in FOLDERS.items()
    }
    with zipfile.ZipFile(io.BytesIO(archive)) as files:
        names = files.namelist()
        assert f'generationTool="diagramc {diagramc.__version__}"'.encode() in files.read(
            "modelDescription.xml"
        )
        sources = [*fmu.sources, *(["buildDescription.xml"] if fmu.fmi == 3 else [])]
        expected = ["modelDescription.xml", *binaries, *(f"sources/{name}" for name in sources)]
        assert names == sorted(expected)
        assert {name: files.read(name) for name in binaries} == binaries
    with zipfile.ZipFile(io.BytesIO(fmu.archive({}))) as files:
        assert not any(name.startswith("binaries") for name in files.namelist())


def test_token_follows_the_content(fmu, lag_source):
    others = [
        replace(fmu, fmi=5 - fmu.fmi),
        replace(fmu, source=replace(fmu.source, tool="another 1.0")),
        replace(fmu, parameters=()),
        replace(fmu, starts={}),
        replace(fmu, source=lag_source(step_s=1e-3)),
    ]
    assert len({fmu.token, *(other.token for other in others)}) == 6
    assert replace(fmu).token == fmu.token


def test_only_double_precision(fmu, lag_source):
    with pytest.raises(CompilationError, match="precision = 'float': must be double in an FMU"):
        replace(fmu, source=lag_source(precision="float"), parameters=())


def test_only_real_inputs(fmu, lag_source):
    source = lag_source()
    counted = replace(source, interface=replace(source.interface, integers=frozenset({"u"})))
    with pytest.raises(CompilationError, match="u: is int32_t; the inputs of an FMU must be real"):
        replace(fmu, source=counted)
