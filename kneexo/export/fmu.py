"""FMUs of a scenario: its controller, its plant or its closed loop for other simulators."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kneexo.compiler.c.export import source_of
from kneexo.compiler.c.source import CSource
from kneexo.compiler.fmu.description import generation_tool
from kneexo.compiler.fmu.fmu import VERSIONS, Fmu
from kneexo.compiler.fmu.variables import Parameter
from kneexo.compiler.model import compile_diagram
from kneexo.diagrams.closed_loop import make_closed_loop, plant_states
from kneexo.errors import KneexoError, OutputError, ParameterError, shown
from kneexo.export.target import Target, require_step, target
from kneexo.files.reading import MIB, read_bytes
from kneexo.files.writing import write_file
from kneexo.parameters import CustomControllerParameters, Scenario, SlidingModeParameters
from kneexo.parameters.paths import changed, value_at
from kneexo.parameters.quantity import Parameters, limits_of, source_of as provenance_of
from kneexo.simulation.compiled import scenario_start, scenario_values, structure_key
from kneexo.systems import knee_reference
from kneexo.version import __version__

TOOL = "kneexo"
"""The generation tool that the FMU's description names."""

_FACTORS = (0.1, 0.5, 0.99, 1.01, 2.0, 10.0)
"""By what a number is changed to see where it goes."""

_AT_REST = "; the initial state does not follow"

_LONGEST_TUPLE = 8  # coefficients, but no samples

_MOST_BYTES = 256 * MIB  # no FMU of kneexo is larger


@dataclass(frozen=True)
class FmuFile:
    """An FMU that was written."""

    path: str
    sample_time_s: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: int
    """How many there are."""
    scenario_parameters: tuple[str, ...]
    """Those that have the names of the scenario."""
    binary: bool
    """Whether it holds a binary; sources alone where there is no C compiler."""


def export_fmu(
    scenario: Scenario,
    path: str | os.PathLike[str],
    what: str = "controller",
    *,
    fmi: int = 3,
    step_s: float | None = None,
) -> FmuFile:
    """Write `make_fmu` with sources and, where there is a C compiler, the binary of this machine.

    ``path``: the file, or a directory for ``knee_plant.fmu``. Raises `OutputError` where something
    lies there that is no FMU of ours, and what `make_fmu` raises.
    """
    file = Path(path)
    if not file.is_dir():
        _require_own(file)  # before the FMU is made, which takes long
    fmu = make_fmu(scenario, what, fmi=fmi, step_s=step_s)
    if file.is_dir() or (file.suffix != ".fmu" and not file.exists()):
        file /= f"{fmu.name}.fmu"
    _require_own(file)
    library = fmu.library()
    write_file(file, fmu.archive(library))
    return FmuFile(
        str(file),
        fmu.source.plan.schedule.tick_s,
        tuple(field.name for field in fmu.source.plan.inputs),
        tuple(field.name for field in fmu.source.plan.outputs),
        len(fmu.parameters),
        tuple(p.name for p in fmu.parameters if value_at(scenario, p.name) is not None),
        library is not None,
    )


def make_fmu(
    scenario: Scenario = Scenario(),
    what: str = "controller",
    *,
    fmi: int = 3,
    step_s: float | None = None,
) -> Fmu:
    """A target of a scenario as FMU.

    A number of the scenario that goes into Context parameters as it is becomes one parameter with
    its dotted name, which sets all of them. Every other Context parameter is a parameter of its
    own. Both may change during a run. The initial states of the plant are fixed parameters.

    Parameters
    ----------
    scenario
        The closed loop; a custom controller too.
    what
        ``controller``, ``plant`` or ``loop``: see `target`.
    fmi
        Version of the standard: 2 or 3.
    step_s
        Largest step of RK4, where there are continuous states; `rk4_step_s` by default.

    Raises
    ------
    ParameterError
        ``what``, ``fmi`` or ``step_s`` is wrong, and as `make_closed_loop`.
    CompilationError
        The target cannot be printed: as `CSource`.
    """
    if fmi not in VERSIONS:
        raise ParameterError(f"fmi = {fmi!r}: must be one of {', '.join(map(str, VERSIONS))}")
    require_step(step_s)
    to_print = target(scenario, what)
    source = source_of(
        compile_diagram(to_print.diagram, inputs=to_print.inputs),
        f"knee_{to_print.what}",
        outputs=[name for name in to_print.outputs if name not in to_print.inputs],
        interface=to_print.interface,
        tick_s=to_print.tick_s,
        step_s=step_s,
        subject=f"{to_print.what} as FMU",
    )
    return Fmu(
        source,
        [*_tunable(scenario, to_print, source), *_initial(scenario, source)],
        fmi,
        f"{TOOL} {__version__}",
        f"{_DESCRIPTIONS[to_print.what]} of a polycentric knee exoskeleton",
        _starts(scenario, to_print, source),
        scenario.simulation.duration_s,
    )


_DESCRIPTIONS = {
    "controller": "controller",
    "plant": "electro-hydraulic actuator, linkage, load and encoder",
    "loop": "closed loop",
}

# ------------------------------------------------------------------------------- parameters


def _tunable(scenario: Scenario, of: Target, source: CSource) -> Iterator[Parameter]:
    """Parameters with names of the scenario, then those of the other Context parameters."""
    prefix = "controller/" if of.what == "controller" else ""
    names = [f"{prefix}{name}" for name in source.equations.parameters]
    members = dict(zip(names, source.plan.members, strict=True))
    values = dict(zip(names, source.parameters.tolist(), strict=True))
    if of.what == "plant":  # which depends on no controller
        scenario = scenario.model_copy(update={"controller": SlidingModeParameters()})
    custom = isinstance(scenario.controller, CustomControllerParameters)
    effects = {} if custom else parameter_effects(scenario, names)
    at_rest = _AT_REST if any(_initial(scenario, source)) else ""
    same = {path: effect.same for path, effect in effects.items() if effect.same}
    claims = [name for group in same.values() for name in group]
    set_by_scenario: set[str] = set()
    for path, group in same.items():
        if any(claims.count(name) > 1 for name in group):
            continue
        set_by_scenario |= group
        low, high = limits_of(_field(scenario, path))
        told = f"sets {', '.join(sorted(group))}"
        told += f"; {provenance_of(_field(scenario, path))}"
        told += at_rest * effects[path].start
        kept = tuple(members[name] for name in names if name in group)
        yield Parameter(path, values[min(group)], kept, told, low, high)
    for name in names:
        if name in set_by_scenario:
            continue
        origin = [path for path, effect in effects.items() if name in effect.touched]
        told = f"Context parameter {name}"
        told += f", computed from {', '.join(origin)}" if origin else ""
        told += at_rest * any(effects[path].start for path in origin)
        yield Parameter(members[name], values[name], (members[name],), told)


@dataclass(frozen=True)
class Effect:
    """What a number of the scenario changes."""

    touched: set[str]
    """Context parameters that follow it."""
    same: set[str]
    """All of these, where they are always equal to it; else none."""
    start: bool
    """Whether the start of the plant follows it."""


def parameter_effects(scenario: Scenario, names: list[str]) -> dict[str, Effect]:
    """Of each number of a scenario, by its dotted path, what it changes of Context parameters.

    Each number is set to the ends of its range and to several others, as far as the scenario
    allows; a change of the form of the equations does not count.
    """
    before, start = scenario_values(scenario), scenario_start(scenario)
    effects = {}
    for path, value, others in _numbers(scenario):
        touched: set[str] = set()
        same: list[set[str]] = []
        moves = False
        for other in others:
            with suppress(KneexoError):
                with_other = changed(scenario, {path.partition("[")[0]: other})
                if structure_key(with_other) != structure_key(scenario):
                    continue
                after = scenario_values(with_other)
                followers = {name for name in names if after[name] != before[name]}
                touched |= followers
                same.append({name for name in followers if after[name] == other})
                moves |= _start(with_other, start) != start
        if touched:
            equal = all(group == touched for group in same)
            equal &= all(before[name] == value for name in touched)
            effects[path] = Effect(touched, touched if equal else set(), moves)
    return effects


def _start(scenario: Scenario, default: dict[str, float]) -> dict[str, float]:
    try:
        return scenario_start(scenario)
    except KneexoError:  # such as a stroke that is too short for it
        return default


def _numbers(parameters: Parameters, path: str = "") -> Iterator[tuple[str, float, list[Any]]]:
    """Each number of parameters: its path, its value, and other values of the field at that path.

    A number of a tuple has the path ``name[index]``.
    """
    for name, field in type(parameters).model_fields.items():
        value = getattr(parameters, name)
        if isinstance(value, Parameters):
            yield from _numbers(value, f"{path}{name}.")
        elif isinstance(value, float) and provenance_of(field):
            low, high = limits_of(field)
            scale = value or 1e-2 * min(high, 1.0)
            numbers = [low, high, *(factor * scale for factor in _FACTORS)]
            others = [n for n in numbers if low <= n <= high and math.isfinite(n) and n != value]
            yield f"{path}{name}", value, others
        elif isinstance(value, tuple) and len(value) <= _LONGEST_TUPLE:
            for i, x in enumerate(value):
                tuples = [(*value[:i], factor * x, *value[i + 1 :]) for factor in _FACTORS]
                yield f"{path}{name}[{i}]", x, tuples


def _field(scenario: Scenario, path: str) -> Any:
    parent, _, name = path.rpartition(".")
    holder = value_at(scenario, parent) if parent else scenario
    return type(holder).model_fields[name]


def _initial(scenario: Scenario, source: CSource) -> Iterator[Parameter]:
    """The initial states of the plant, which rests at an angle of the knee."""
    start = math.degrees(knee_reference.start_angle_rad(scenario.reference))
    variables = plant_states(scenario)
    told = f"the scenario starts at rest, the knee at {start:.6g} deg"
    if scenario.initial_offset_m:
        told += f", the rod {scenario.initial_offset_m:g} m further out"
    for i, name in enumerate(source.equations.states):
        if name in variables:
            column, factor = variables[name]
            yield Parameter(
                f"initial.{column}",
                factor * float(source.state.continuous[i]),
                (f"initial_x[{i}]",),
                told,
                divisor=factor,
                tunable=False,
            )


def _starts(scenario: Scenario, of: Target, source: CSource) -> dict[str, float]:
    """Start values of inputs: what the closed loop gives at its start, zero where it gives none."""
    loop = make_closed_loop(scenario, signals=())
    context = loop.CreateDefaultContext()
    plant = loop.GetSubsystemByName("plant")
    within = plant.GetMyContextFromRoot(context)
    values: dict[str, list[float]] = {}
    for name in of.inputs:
        if loop.HasOutputPort(name):
            values[name] = loop.GetOutputPort(name).Eval(context).tolist()
        elif plant.HasOutputPort(name):
            values[name] = plant.GetOutputPort(name).Eval(within).tolist()
    elements: Mapping[str, Iterator[float]] = {name: iter(row) for name, row in values.items()}
    inputs = [field for field in source.plan.inputs if field.port in elements]
    return {field.name: next(elements[field.port]) for field in inputs}


# ------------------------------------------------------------------------------------- files


def _require_own(file: Path) -> None:
    """Raise `OutputError` where something lies that we did not make."""
    try:
        tool = generation_tool(read_bytes(file, _MOST_BYTES))
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(f"--out {shown(file)}: {reason}; choose another file") from None
    if not (tool or "").startswith(TOOL):
        what = "no FMU" if tool is None else f"an FMU of {shown(tool) or 'another tool'}"
        raise OutputError(f"--out {shown(file)}: is {what}; choose another file")
