"""FMUs in FMPy, which tests of `export` use too; the FMU of a small diagram."""

import os
import shutil
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    DiscreteTimeDelay,
    Gain,
    LinearSystem,
)

from diagramc import read_diagram, write_fmu
from diagramc.c.cross import PLATFORMS
from diagramc.c.interface import Interface
from diagramc.c.source import source_of
from diagramc.fmu.fmu import Fmu
from diagramc.fmu.variables import FmuParameter


class FmuInstance:
    """An FMU in FMPy, by names of variables, in either version of the standard."""

    def __init__(self, path, guid=None, name="knee"):
        fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
        from fmpy import fmi2, fmi3

        self.description = fmpy.read_model_description(path)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages = []
        self.two = self.description.fmiVersion == "2.0"
        kind = fmi2.FMU2Slave if self.two else fmi3.FMU3Slave
        self.fmu = kind(
            guid=guid or self.description.guid,
            unzipDirectory=fmpy.extract(path),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        if self.two:
            callbacks = fmi2.fmi2CallbackFunctions()
            callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log)
            self.fmu.instantiate(callbacks=callbacks)
        else:
            self.fmu.instantiate(logMessage=self._log)

    def _log(self, *arguments):
        self.messages.append(arguments[-1].decode())

    def enter(self, start=0.0, stop=None, **values):
        """Begin the initialization, with start values."""
        self.set(**values)
        if self.two:
            self.fmu.setupExperiment(startTime=start, stopTime=stop)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start, stopTime=stop)

    def start(self, start=0.0, stop=None, **values):
        """Initialize, with start values; returns self."""
        self.enter(start, stop, **values)
        self.fmu.exitInitializationMode()
        return self

    def set(self, values=(), **named):
        named = dict(values) | named
        names, numbers = zip(*named.items(), strict=True) if named else ((), ())
        references = [self.references[name] for name in names]
        (self.fmu.setReal if self.two else self.fmu.setFloat64)(references, numbers)

    def get(self, *names):
        references = [self.references[name] for name in names]
        values = (self.fmu.getReal if self.two else self.fmu.getFloat64)(references)
        return values[0] if len(names) == 1 else values

    def step(self, time, size=0.002):
        self.fmu.doStep(time, size)

    def save(self):
        return self.fmu.getFMUstate() if self.two else self.fmu.getFMUState()

    def restore(self, state):
        (self.fmu.setFMUstate if self.two else self.fmu.setFMUState)(state)

    def serialize(self):
        state = self.save()
        return (self.fmu.serializeFMUstate if self.two else self.fmu.serializeFMUState)(state)

    def deserialize(self, data):
        fmu = self.fmu
        self.restore((fmu.deSerializeFMUstate if self.two else fmu.deserializeFMUState)(data))

    def refusal(self, call, *arguments, **named):
        """The message of a call that must fail."""
        from fmpy.fmi1 import FMICallException

        before = len(self.messages)
        with pytest.raises(FMICallException):
            call(*arguments, **named)
        (message,) = self.messages[before:]
        return message


@pytest.fixture(scope="session")
def fmu_instance():
    """The class of FMU instances; skips without FMPy."""
    pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    return FmuInstance


EMULATORS = {
    "x86_64-linux": ("env",),
    "aarch64-linux": ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
    "x86_64-windows": ("wine",),
}
"""Commands that run a program of a platform on Linux. Debian: qemu-user, libc6-arm64-cross, wine.

The command env runs a program of this machine.
"""


@pytest.fixture(scope="session")
def run_elsewhere(tmp_path_factory):
    """``run_elsewhere(path, platform, steps, tick_s)``: the outputs of an FMU on a platform.

    Skips where a tool is missing. Inputs are those of driver.c. Returns (steps, outputs).
    """

    def run(path, platform, steps, tick_s):
        folder = _with_driver(tmp_path_factory, platform)
        with zipfile.ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            name = root.find("CoSimulation").get("modelIdentifier")
            end = f"{name}{PLATFORMS[platform].suffix}"
            two = {"x86_64-linux": "linux64", "x86_64-windows": "win64"}
            folders = (platform, two.get(platform))
            (library,) = (
                m for m in archive.namelist() if m.endswith(end) and m.split("/")[1] in folders
            )
            (folder / end).write_bytes(archive.read(library))
        token = root.get("guid") or root.get("instantiationToken")
        causes = [variable.get("causality") for variable in root.find("ModelVariables")]
        outputs = causes.count("output")
        numbers = [tick_s, steps, causes.count("input"), causes.index("output"), outputs]
        command = [*EMULATORS[platform], "./driver", f"./{end}", root.get("fmiVersion")[0], token]
        environment = os.environ | {"WINEPREFIX": str(folder / "wine"), "WINEDEBUG": "-all"}
        ended = subprocess.run(
            [*command, *map(str, numbers)],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert ended.returncode == 0, ended.stderr
        return np.array(ended.stdout.split(), dtype=float).reshape(steps, outputs)

    return run


def _with_driver(tmp_path_factory, platform):
    """A folder with driver.c, compiled for a platform."""
    if find_spec("ziglang") is None:
        pytest.skip("needs Zig: pip install ziglang")
    emulator = EMULATORS[platform]
    if shutil.which(emulator[0]) is None or not all(map(os.path.exists, emulator[2:])):
        pytest.skip(f"needs {' '.join(emulator)}")
    folder = tmp_path_factory.mktemp("driver")
    source = Path(__file__).with_name("driver.c")
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[platform].target, "-O1"]
    libraries = [] if platform.endswith("windows") else ["-ldl"]
    subprocess.run([*zig, str(source), "-o", "driver", *libraries], cwd=folder, check=True)
    return folder


def _lag_source(**options):
    """A lag, dx/dt = 3 (u + offset) - 2 x, and x a sample late."""
    builder = DiagramBuilder()
    offset = builder.AddNamedSystem("offset", ConstantVectorSource([0.0]))
    sum_ = builder.AddNamedSystem("sum", Adder(2, 1))
    gain = builder.AddNamedSystem("gain", Gain(3.0, 1))
    lag = builder.AddNamedSystem("lag", LinearSystem([[-2.0]], [[1.0]], [[1.0]], [[0.0]]))
    delay = builder.AddNamedSystem("delay", DiscreteTimeDelay(0.1, 1, 1))
    builder.Connect(offset.get_output_port(), sum_.get_input_port(1))
    builder.Connect(sum_.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), lag.get_input_port())
    builder.Connect(lag.get_output_port(), delay.get_input_port())
    builder.ExportInput(sum_.get_input_port(0), "u")
    builder.ExportOutput(lag.get_output_port(), "x")
    builder.ExportOutput(delay.get_output_port(), "late")
    builder.ExportOutput(gain.get_output_port(), "direct")
    diagram = builder.Build()
    interface = Interface({"u": ["u_m_s"], "x": ["x_m"], "late": ["late_m"], "direct": ["d_m_s"]})
    read = read_diagram(diagram, inputs=["u"])
    return source_of(read, "lag", interface=interface, **options)


@pytest.fixture(scope="session")
def lag_source():
    """``lag_source(**options)``: the C source of a lag."""
    return _lag_source


PARAMETERS = (
    FmuParameter("offset_m_s", 0.0, ("offset.group_0[0]",), "added to the input"),
    FmuParameter("initial.x_mm", 500.0, ("initial_x[0]",), "where x starts", 0.0, 2e3, 1e3, False),
)


@pytest.fixture(scope="session", params=[2, 3])
def fmu(request):
    """The FMU of the lag, in each version of the standard."""
    return Fmu(_lag_source(), PARAMETERS, request.param, "a lag", {"u_m_s": 0.25}, 5.0)


@pytest.fixture(scope="session")
def path(fmu, tmp_path_factory):
    """File of the FMU of the lag; skips without a C compiler."""
    file = tmp_path_factory.mktemp("fmu") / "lag.fmu"
    if not write_fmu(file, fmu).platforms:
        pytest.skip("needs a C compiler on Linux in 64 bits")
    return file


@pytest.fixture(scope="session")
def lag_parameters():
    """A tunable and a fixed parameter of the lag."""
    return PARAMETERS
