"""Makes test vectors: the inputs of each step, and the outputs that the C code must return."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import ZeroOrderHold

from ..diagram_equations import DiagramEquations
from ..errors import CompilationError
from ..model import DiagramModel, compile_diagram
from ..run_data import Array, InputTable, State
from .source import CSource


@dataclass(frozen=True)
class Vectors:
    """Test vectors: inputs (steps, input elements), expected outputs (steps, output elements).

    ``fastest_per_s`` is the largest |λ| of the run: see `CompiledModel.fastest_per_s`.
    """

    inputs: Array
    outputs: Array
    fastest_per_s: float = 0.0


def recorded_vectors(diagram: System, source: CSource, inputs: Array) -> Vectors:
    """Run the compiled diagram with the inputs of each step; return inputs and recorded outputs.

    Inputs are constant over a step. Outputs are recorded just before the updates of the next step.
    The integrator is RK4 with the step size of ``source``. For the Rosenbrock method it is another
    method, the exact hold with a hundredth of the tolerance of ``source``.

    Parameters
    ----------
    diagram
        The diagram whose equations ``source`` has.
    source
        The model in C. The run uses the parameters, initial state, ticks and outputs of ``source``.
    inputs
        Inputs of each step (steps, input elements).

    Raises
    ------
    CompilationError
        There are no steps or no outputs, so the test vectors would be empty. Or the inputs vary
        from step to step, and the diagram has continuous states and sample times.
    SimulationError
        The run fails.
    """
    if not len(inputs):
        raise CompilationError(f"{source.name}: test vectors have 0 steps; must be at least 1")
    if not source.plan.outputs:
        raise CompilationError(
            f"{source.name}: test vectors need an output; export an output port of the diagram"
        )
    schedule, equations, state = source.plan.schedule, source.equations, source.state
    model = DiagramModel(DiagramEquations(diagram, equations))
    tick_s, steps, ports = schedule.tick_s, len(inputs), tuple(source.equations.inputs)
    ends_s: Array = tick_s * np.arange(1.0, steps + 1.0)
    if equations.states and ports:
        # The last stage of a step lies at the end of the step, and would read the next input.
        if equations.updates and np.ptp(inputs, axis=0).any():
            raise CompilationError(
                f"{source.name}: has continuous states, sample times and inputs; test vectors need "
                f"inputs that are constant"
            )
        if not equations.updates:
            model = compile_diagram(_with_holds(diagram, ports, tick_s), inputs=ports)
            state = State(state.continuous, np.concatenate([state.discrete, inputs[0]]))
    table = model.no_inputs
    if ports:
        table = InputTable(ends_s, np.concatenate([inputs, inputs[-1:]])[:, :, None])
    # Without continuous states an output may follow an input at once, and an output at the end of a
    # step would read the next input.
    records: dict[str, Any] = {"record_times_s": ends_s - 1e-6 * tick_s}
    if equations.states:
        records = {"record_period_s": tick_s}
    start = model.initialized(source.parameters, state, table)
    how: dict[str, Any] = {"integrator": "rk4", "step_s": schedule.largest_step_s}
    if source.rosenbrock_tolerance is not None:  # a second method does not repeat an error of C
        how = {"integrator": "exact_hold", "tolerance": 0.01 * source.rosenbrock_tolerance}
    how["inputs"] = table
    values, end_s = source.parameters, steps * tick_s
    run = model.simulate(values, start, end_s, outputs=source.output_ports, **how, **records)
    outputs = np.hstack([run[name] for name in source.output_ports])
    if not equations.states:
        return Vectors(inputs, outputs[-steps:])
    fastest_per_s = model.fastest_per_s(values, start, end_s, record_period_s=tick_s, **how)
    return Vectors(inputs, outputs[-steps:], fastest_per_s)


def _with_holds(diagram: System, ports: Sequence[str], tick_s: float) -> System:
    """Return a copy of the diagram with a zero-order hold before each input port."""
    builder = DiagramBuilder()
    model = builder.AddNamedSystem("model", diagram.Clone())
    for name in ports:
        port = model.GetInputPort(name)
        hold = builder.AddNamedSystem(f"hold_{name}", ZeroOrderHold(tick_s, port.size()))
        builder.Connect(hold.get_output_port(), port)
        builder.ExportInput(hold.get_input_port(), name)
    for index in range(model.num_output_ports()):
        port = model.get_output_port(index)
        builder.ExportOutput(port, port.get_name())
    return builder.Build()
