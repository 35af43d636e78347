"""Shared by the tests of compilation: IR text as functions, and a diagram."""

import ctypes

import llvmlite.binding as llvm
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Gain,
    LinearSystem,
    LogVectorOutput,
    Saturation,
    Sine,
    ZeroOrderHold,
)


def object_code(text, cpu=None, features="", triple=None):
    """Machine code of IR text, for this processor or another one."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    if cpu is None:
        cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_triple(triple or llvm.get_process_triple())
    machine = target.create_target_machine(cpu, features, opt=3, reloc="pic", codemodel="small")
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    module.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.slp_vectorization = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return machine.emit_object(module)


@pytest.fixture(scope="session")
def native():
    """``native(text)(name, result, *arguments)``: a function of IR text, with ctypes' types."""

    def load(text, cpu=None):
        code = object_code(text, cpu)
        machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        engines.append(engine)

        def function(name, result, *arguments):
            return ctypes.CFUNCTYPE(result, *arguments)(engine.get_function_address(name))

        return function

    engines = []  # the code lives as long as they do
    return load


@pytest.fixture(scope="session")
def assembled():
    """``assembled(text, cpu, features, triple)``: machine code, not loaded."""
    return object_code


@pytest.fixture
def multirate():
    """A sine, held every 4 ms, through a plant, sampled every 10 ms from 5 ms on; nested."""
    inner = DiagramBuilder()
    plant = inner.AddNamedSystem(
        "plant",
        LinearSystem(A=[[0.0, 1.0], [-400.0, -4.0]], B=[[0.0], [400.0]], C=[[1.0, 0.0]], D=[[0.0]]),
    )
    limit = inner.AddNamedSystem("limit", Saturation(min_value=[-0.7], max_value=[0.7]))
    inner.Connect(limit.get_output_port(), plant.get_input_port())
    inner.ExportInput(limit.get_input_port(), "u")
    inner.ExportOutput(plant.get_output_port(), "y")
    inner = inner.Build()
    inner.set_name("inner")
    builder = DiagramBuilder()
    sine = builder.AddNamedSystem("sine", Sine(1.0, 10.0, 0.3, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.004, 1))
    builder.AddNamedSystem("inner", inner)
    sampler = builder.AddNamedSystem("sampler", ZeroOrderHold(0.010, 1, offset_sec=0.005))
    gain = builder.AddNamedSystem("gain", Gain(2.0, 1))
    builder.Connect(sine.get_output_port(0), hold.get_input_port())
    builder.Connect(hold.get_output_port(), inner.get_input_port())
    builder.Connect(inner.get_output_port(), sampler.get_input_port())
    builder.Connect(sampler.get_output_port(), gain.get_input_port())
    for name, system in (("y", inner), ("sampled", gain), ("held", hold)):
        builder.ExportOutput(system.get_output_port(), name)
        log = LogVectorOutput(system.get_output_port(), builder, publish_period=0.002)
        log.set_name(f"log_{name}")
    return builder.Build()
