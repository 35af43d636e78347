"""One run of a compiled model as a JSON file, from which the run is repeated bit for bit.

Python writes a float with as many digits as identify its bits. So the file holds every number
exactly. The file holds no code.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .errors import Error, ParameterError, SimulationError, shortened, shown
from .json_files import (
    document_text,
    mapping_of,
    number_of,
    numbers_of,
    read_document,
    text_of,
    write_document,
)
from .model import CompiledModel, Simulation
from .native.runner import STEP_S, TOLERANCE
from .run_data import Array, InputTable, State
from .run_end import Replay, RunEnd, run_versions, version_changes

_KIND = "run of a diagram"


@dataclass(frozen=True)
class RecordedRun:
    """The arguments of one run of a compiled model, and its end. `record_run` makes it."""

    equations: str
    """Digest of the model's key, which identifies the equations."""
    parameters: Mapping[str, float]
    state: Mapping[str, float]
    """Continuous and discrete states at t = 0, after the initialization events."""
    input_ports: Mapping[str, int]
    """Number of elements of each open input port."""
    inputs: InputTable
    duration_s: float
    options: Mapping[str, Any]
    """Options of `CompiledModel.simulate`: integrator, step, tolerance, outputs, record period."""
    end: RunEnd
    versions: Mapping[str, str]
    note: Mapping[str, Any]
    """Data of the user, such as the seed of a study and the number of the run."""

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the run to a file, replacing an earlier file.

        Raises `OutputError`, and `ParameterError` if the note is no JSON data.
        """
        write_document(path, self.text())

    def text(self) -> str:
        """Return the text of the run's file. Raises `ParameterError` if the note is no JSON."""
        document = {
            "equations": self.equations,
            "parameters": dict(self.parameters),
            "state": dict(self.state),
            "input_ports": dict(self.input_ports),
            "inputs": {
                "breaks": self.inputs.breaks.tolist(),
                "coefficients": self.inputs.coefficients.tolist(),
            },
            "duration_s": self.duration_s,
            "options": dict(self.options),
            "end": self.end.plain(),
            "versions": dict(self.versions),
            "note": dict(self.note),
        }
        return document_text(_KIND, document)

    def simulate(self, model: CompiledModel) -> Simulation:
        """Repeat the run on ``model`` and return its records.

        Raises `SimulationError` if the run fails, and `ParameterError` if ``model`` has other
        parameters, states or open inputs than the recorded run, or if an option is wrong.
        """
        names = (*model.state_names, *model.discrete_names)
        start = _in_order("state", self.state, names)
        if self.input_ports != model.inputs:
            raise ParameterError(
                f"inputs: the run has {_ports(self.input_ports)}, the model has "
                f"{_ports(model.inputs)}; compile the diagram with the inputs of the run"
            )
        parameters = _in_order("parameters", self.parameters, model.parameter_names)
        count = len(model.state_names)
        state = State(start[:count], start[count:])
        try:
            return model.simulate(
                parameters, state, self.duration_s, inputs=self.inputs, **self.options
            )
        except Error:
            raise
        except (ValueError, OverflowError) as error:  # of a file that another program wrote
            raise ParameterError(f"the run cannot start: {error}") from None

    def replay(self, model: CompiledModel) -> Replay:
        """Repeat the run on ``model`` and compare its end. Errors: see `simulate`.

        A model with other equations runs too, if its names are those of the run. The result then
        says that the equations changed. The bits also depend on the processor.
        """
        end = _end_of(model, lambda: self.simulate(model))
        now = run_versions() | {"equations": _digest(model)}
        then = {**self.versions, "equations": self.equations}
        return Replay(end, self.end.difference(end), version_changes(then, now))


def record_run(
    model: CompiledModel,
    parameters: Array,
    state: State,
    duration_s: float,
    *,
    inputs: InputTable | None = None,
    note: Mapping[str, Any] = {},
    **options: Any,
) -> RecordedRun:
    """Repeat one run of a batch, and return its arguments and its end, ready for a file.

    The repeated run has the same bits as the run in the batch. So any run of
    `CompiledModel.simulate_batch` can be recorded afterwards, and a sweep need not record its runs.

    Parameters
    ----------
    model, parameters, state, duration_s, inputs, options
        As in `CompiledModel.simulate`, without ``record_times_s``. For a run of a batch they are
        the arguments of this run.
    note
        JSON data that the file keeps, such as ``{"seed": 1, "run": 4711}``.

    Raises
    ------
    ParameterError, ValueError
        As in `CompiledModel.simulate`. A `SimulationError` is not raised but recorded.
    """
    table = model.no_inputs if inputs is None else inputs
    settings: dict[str, Any] = {
        "outputs": list(model.outputs),
        "record_period_s": None,
        "integrator": "exact_hold",
        "step_s": STEP_S,
        "tolerance": TOLERANCE,
    }
    settings |= {name: value for name, value in options.items() if value is not None}
    _require_options(settings)
    arguments = np.asarray(parameters, dtype=float)
    end = _end_of(
        model, lambda: model.simulate(arguments, state, duration_s, inputs=table, **settings)
    )
    names = (*model.state_names, *model.discrete_names)
    start = np.concatenate((state.continuous, state.discrete)).tolist()
    return RecordedRun(
        equations=_digest(model),
        parameters=dict(zip(model.parameter_names, arguments.tolist(), strict=True)),
        state=dict(zip(names, start, strict=True)),
        input_ports=model.inputs,
        inputs=table,
        duration_s=float(duration_s),
        options=settings | {"outputs": list(settings["outputs"])},
        end=end,
        versions=run_versions(),
        note=note,
    )


def read_run(path: str | os.PathLike[str]) -> RecordedRun:
    """Read a file that `RecordedRun.write` made.

    Raises `ParameterError` if the file cannot be read, is larger than `MOST_BYTES`, or is no such
    file. The message is one line with the entry and what it must be.
    """
    document = read_document(path, _KIND)
    try:
        table = mapping_of("inputs", document.get("inputs"))
        try:
            inputs = InputTable(
                *(np.array(table.get(name), dtype=float) for name in ("breaks", "coefficients"))
            )
            if (inputs.breaks.ndim, inputs.coefficients.ndim) != (1, 3):
                raise ValueError("must be arrays (n,) and (segments, inputs, powers)")
        except (ValueError, TypeError, OverflowError) as error:
            raise ParameterError(f"inputs: {error}") from None
        ports = numbers_of("input_ports", document.get("input_ports"))
        options = mapping_of("options", document.get("options"))
        _require_options(options)
        return RecordedRun(
            equations=text_of("equations", document.get("equations")),
            parameters=numbers_of("parameters", document.get("parameters")),
            state=numbers_of("state", document.get("state")),
            input_ports={name: int(size) for name, size in ports.items()},
            inputs=inputs,
            duration_s=number_of("duration_s", document.get("duration_s")),
            options=options,
            end=RunEnd.from_plain(document.get("end")),
            versions=mapping_of("versions", document.get("versions")),
            note=mapping_of("note", document.get("note")),
        )
    except ParameterError as error:
        raise ParameterError(f"{shown(path)}: {error}") from None


def _end_of(model: CompiledModel, simulate: Callable[[], Simulation]) -> RunEnd:
    """Call ``simulate`` and return how the run ended."""
    try:
        run = simulate()
    except SimulationError as error:
        return RunEnd.of(error)
    values = np.concatenate((run.final.continuous, run.final.discrete)).tolist()
    names = (*model.state_names, *model.discrete_names)
    time_s = float(run.time_s[-1])
    return RunEnd("", "", time_s, dict(zip(names, values, strict=True)))


def _in_order(what: str, values: Mapping[str, float], names: Sequence[str]) -> Array:
    """Return the values in the order of ``names``. Raise `ParameterError` for other names."""
    if values.keys() != set(names):
        lacking = [f"lacks {name}" for name in sorted(set(names) - values.keys())]
        unknown = [f"has {name}" for name in sorted(values.keys() - set(names))]
        text = shortened(", ".join([*lacking, *unknown]), 300)
        raise ParameterError(f"{what}: the run {text}; must have those of the model")
    return np.array([values[name] for name in names], dtype=float)


def _ports(ports: Mapping[str, int]) -> str:
    return shortened(", ".join(f"{name} ({size})" for name, size in ports.items()), 200) or "none"


def _digest(model: CompiledModel) -> str:
    return hashlib.sha256(model.code.key.encode()).hexdigest()


def _require_options(options: Mapping[str, Any]) -> None:
    """Raise `ParameterError` for an unknown option or an option of a wrong type."""
    kinds: dict[str, tuple[type, ...]] = {
        "outputs": (list, tuple),
        "record_period_s": (float, int, type(None)),
        "integrator": (str,),
        "step_s": (float, int),
        "tolerance": (float, int),
    }
    for name, value in options.items():
        if name not in kinds:
            raise ParameterError(
                f"options.{shortened(name)}: is unknown, must be one of {', '.join(kinds)}"
            )
        if not isinstance(value, kinds[name]) or isinstance(value, bool):
            raise ParameterError(f"options.{name}: has a value of the wrong type")
