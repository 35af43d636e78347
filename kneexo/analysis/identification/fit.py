"""Fits numbers of a scenario to a log of the real machine: open loop, and in the whole loop.

Open loop the plant gets the logged command. Noise of the encoder returns through the controller
into this command, so that the estimates have a bias. In the whole loop the controller of the
scenario follows the logged reference, and an error of this controller is a bias. The difference of
both estimates shows either (Ljung, System Identification, 1999, 13.4 and 13.5).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from diagramc import (
    CompiledModel,
    Fit,
    InputTable,
    Log,
    State,
    Unknown,
    identify,
    stack_tables,
)
from kneexo.analysis.identification.machine_log import (
    AT_LIMIT,
    COMMAND,
    ELEMENT_OF,
    ENCODER,
    OFFSET,
    REFERENCE,
    SPEED,
    START_M,
    TIME,
    check,
    check_range,
    compare,
    named_in_errors,
    phase_rad,
    read_log,
)
from kneexo.common.plotting import BLUE, GOLD, axes_or_new
from kneexo.common.result import Array, Result
from kneexo.diagrams.closed_loop import plant_states
from kneexo.errors import KneexoError, LinkageError, ParameterError, SimulationError, shown
from kneexo.geometry.linkage import eq6_sign, knee_angle_from_encoder, polynomial
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.parameters import SampledReference, Scenario, Uncertainty, UncertaintySet
from kneexo.parameters.fields.fields import allowed_range, limits_of, unit_of
from kneexo.parameters.paths import has_path, value_at
from kneexo.parameters.scenario_file import as_scenario
from kneexo.simulation import compilation
from kneexo.simulation.compiled import (
    compile_open_loop,
    reference_table,
    scenario_run,
)
from kneexo.systems.knee_reference import start_angle_rad

_DECADE = 10.0  # ends of a range that the user leaves out, as factors of the scenario's value
_ROUNDED = 1.5  # of the deviation of rounding: less is hardly noise
_SENSOR = {"delay_s": (0.0, "s"), "gain": (1.0, ""), "bias": (0.0, "")}  # without error


@dataclass(frozen=True, repr=False)
class FittedScenario(Result):
    """A scenario with numbers that were fitted to a log; ``str`` gives a table with notes."""

    scenario: Scenario
    """The scenario with the numbers found open loop. Its controller keeps its nominal plant."""
    log_name: str
    paths: tuple[str, ...]
    """Dotted paths of the fitted numbers of the scenario."""
    time_s: Array
    """Stamps (n,) of the compared rows in s, from the first sample on."""
    measured: dict[str, Array]
    """Compared columns (n,) by name. Readings of the encoder are θ_4, not rounded down."""
    predicted: dict[str, Array]
    """What the fit predicts open loop for each column (n,)."""
    trained: NDArray[np.bool_]
    """Whether a row took part in the fit (n,)."""
    open_loop: Fit
    """Fit of the plant, with the logged command as input."""
    whole_loop: Fit | None
    """Fit of plant and controller, with the logged reference as input; None without it."""
    notes: tuple[str, ...]

    def uncertainty(self) -> UncertaintySet:
        """Return the intervals of the fitted numbers as uncertain values, for the robustness study.

        An `UncertaintySet` has no correlation. So values that the log hardly tells apart vary
        further than the log allows. Raises `ParameterError` if only sensors were fitted.
        """
        values = {}
        for path, text in self.provenance().items():
            low, high = self.open_loop.interval[path]
            scale: Any = "log" if low > 0.0 else "linear"
            values[path] = Uncertainty(low=low, high=high, scale=scale, source=text)
        return UncertaintySet(values=values)

    def provenance(self) -> dict[str, str]:
        """Return where each fitted number of the scenario comes from, by dotted path."""
        rows, text = self.results()["unknowns"], f"fitted to {self.log_name}, ±"
        return {n: f"{text} {rows[n]['half']:.2g} (95 %, {rows[n]['word']})" for n in self.paths}

    def results(self) -> dict[str, Any]:
        """Return the numbers of the fit as plain data.

        ``difference`` is the value of the whole loop less that of the open loop, in combined
        standard deviations.
        """
        fit, whole = self.open_loop, self.whole_loop
        unknowns, outputs = {}, {}
        for place, (unknown, name) in enumerate(zip(fit.unknowns, fit.names, strict=True)):
            (low, high), value = fit.interval[name], fit.values[name]
            second = math.nan if whole is None else whole.values[name]
            variance = sum(each.covariance[place, place] for each in (fit, whole or fit))
            unknowns[name] = {
                "value": value,
                "low": low,
                "high": high,
                "half": 0.5 * (high - low),
                "unit": unknown.unit,
                "word": fit.words[name],
                "whole_loop": second,
                "difference": float((second - value) / math.sqrt(variance)),
            }
        for name in fit.noise:
            outputs[name] = {
                "noise": fit.noise[name],
                "correlation_time_s": fit.correlation_time_s[name],
                "explained_percent": fit.train[name],
                "held_out_percent": fit.validation.get(name, math.nan),
                "white_p": fit.whiteness[name],
            }
        notes = [*fit.notes, *self.notes]
        return {"rows": self.time_s.size, "unknowns": unknowns, "outputs": outputs, "notes": notes}

    def __str__(self) -> str:
        """Return the table of the open loop, the values of the whole loop, and the notes."""
        second = [
            f"{name}: {row['whole_loop']:.5g} in the whole loop, {row['difference']:+.1f} combined "
            f"standard deviations"
            for name, row in self.results()["unknowns"].items()
            if self.whole_loop
        ]
        return "\n".join([str(self.open_loop), *second, *self.notes])

    def plot(self, axes: Any = None) -> Any:
        """Plot what was measured and predicted, and the residuals; return the axes (n, 2)."""
        caption = f"Fit to {self.log_name}, open loop. The rows in the shade took no part."
        rows = len(self.measured)
        shape = {"squeeze": False, "figsize": (10.0, 2.0 + 1.8 * rows)}
        axes = axes_or_new(axes, rows, 2, caption=caption, **shape)
        for (left, right), (name, values) in zip(axes, self.measured.items(), strict=True):
            left.plot(self.time_s, values, color=GOLD, label="measured")
            left.plot(self.time_s, self.predicted[name], color=BLUE, ls="--", label="predicted")
            right.plot(self.time_s, self.predicted[name] - values, ".", ms=2, color=BLUE)
            left.set(xlabel="time (s)", ylabel=name)
            right.set(xlabel="time (s)", ylabel="predicted less measured")
            for ax in () if self.trained.all() else (left, right):
                ax.axvspan(self.time_s[self.trained.argmin()], self.time_s[-1], color="0.9")
        axes[0, 0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
        return axes


def fit(
    scenario: Scenario | str | os.PathLike[str],
    log: str | os.PathLike[str] | Mapping[str, ArrayLike],
    parameters: Sequence[str],
    *,
    measured: Sequence[str] = (),
    columns: Sequence[str] = (),
    command_holds: Literal["until", "from"] = "until",
    whole_loop: bool = True,
    **options: Any,
) -> FittedScenario:
    """Fit numbers of a scenario to a log of the machine, and say how far to trust each of them.

    The log has a row for each sample of the controller: the time, the speed command that reached
    the motor, what was measured, and for the whole loop the reference. It begins with the knee at
    rest. The position of the rod at its start, ``initial_offset_m``, is found too.

    Parameters
    ----------
    scenario
        What is known of the machine, or the path of a scenario file. Its numbers are the start of
        the search.
    log
        Path of a CSV file, or columns by name. The names are those that ``kneexo simulate`` writes.
    parameters
        Dotted paths of numbers of the scenario, and ``OUTPUT.delay_s``, ``OUTPUT.gain`` and
        ``OUTPUT.bias`` of a sensor, such as ``encoder_reading.delay_s``. ``NAME=LOW:HIGH`` gives
        the range. Left out, it is a tenth to ten times the value; a value of zero needs a range.
    measured
        Names of the columns to compare. Left out: encoder and motor speed, if the log has them.
    columns
        For a column of another name ``NAME=COLUMN``, and for another unit ``NAME=COLUMN*FACTOR``.
    command_holds
        ``until``: the motor had the command of a row until the time of the row, as in a run of
        kneexo. ``from``: it has the command from there on.
    whole_loop
        Whether to fit the whole loop too, if the log has the reference.
    options
        ``validation``, ``loss``, ``starts`` and ``seed`` as in `diagramc.identify`.

    Raises
    ------
    ParameterError
        A parameter is not a number of this scenario or has no effect. A column is missing, or
        contradicts the scenario: its unit, its sign, its limits or its times.
    SimulationError
        The run with the numbers of the scenario fails.

    Examples
    --------
    The log of a simulated machine with a slower drive.

    >>> import kneexo as kx
    >>> change = {"plant.pump.lag_s": 0.012, "simulation.duration_s": 0.5}
    >>> log = kx.track(kx.Scenario().changed(change), all_signals=True).run.columns
    >>> found = kx.fit(kx.Scenario(), log, ["plant.pump.lag_s"], whole_loop=False)
    >>> print(f"lag {found.scenario.plant.pump.lag_s:.4f} s")
    lag 0.0120 s
    """
    scenario = as_scenario(scenario)
    logged, period_s = read_log(log, columns, measured), scenario.controller.sample_time_s
    path = "log" if isinstance(log, Mapping) else os.fspath(log)
    with named_in_errors(path):
        check(logged, scenario)
    compared = measured or [name for name in (ENCODER, SPEED) if name in logged]
    values = {name: logged[name] + phase_rad(scenario) * (name == ENCODER) for name in compared}
    held = logged[COMMAND]
    if command_holds == "until":
        held = np.append(held[1:], held[-1])
    # Most stamps are a whole number of sample times behind the machine's first sample.
    time_s = logged[TIME] - logged[TIME][0]
    time_s -= np.median(time_s - period_s * np.rint(time_s / period_s))
    elements = {ELEMENT_OF[name]: column for name, column in values.items()}
    part = Log(time_s, elements, period_s, {"motor_speed_command": held})
    # A quantizer would make the differences of the Jacobian jump.
    kept = {"plant": scenario.plant, "nominal": scenario.believed_plant}
    smooth = scenario.without_quantizers().model_copy(update=kept)
    unknowns = [_unknown(smooth, text, part) for text in parameters]
    paths = tuple(unknown.name for unknown in unknowns if has_path(smooth, unknown.name))
    start = _started(smooth, logged, values.get(ENCODER), time_s)
    model, command = compile_open_loop(smooth), part.table({"motor_speed_command": 1})
    if "knee_reference" in model.inputs:
        command = stack_tables(command, reference_table(start.reference))
    names = *paths, OFFSET
    at = _at(model, start, names, command)
    with named_in_errors(path), suppress(SimulationError):  # which `identify` raises again
        numbers, state, inputs = at({OFFSET: 0.0}, part)
        times_s = np.maximum(time_s, 0.0)
        run = model.simulate(numbers, state, times_s[-1], inputs=inputs, record_times_s=times_s)
        places = (ELEMENT_OF[name].rstrip("]").partition("[") for name in compared)
        predicted = (run[port][:, int(index or 0)] for port, _, index in places)
        compare(logged, dict(zip(compared, predicted, strict=True)), scenario)
    with named_in_errors(path):
        check_range(logged, scenario)
    if OFFSET not in paths:
        begin = start.initial_offset_m
        unknowns.append(Unknown(OFFSET, begin - START_M, begin + START_M, begin, "m"))
    found = identify(model, part, unknowns, at=at, **options)
    notes, whole = [], None
    if at_limit := np.mean(np.abs(held) > AT_LIMIT * scenario.command_limit_rad_s):
        notes.append(f"{COMMAND}: is at its limit in {100.0 * at_limit:.2g} % of the rows")
    count = scenario.encoder.resolution_rad / math.sqrt(12.0)  # deviation of rounding
    if found.noise.get("encoder_reading", math.inf) < _ROUNDED * count:
        notes.append(
            "encoder_reading: its residuals are mostly rounding, so a true value can lie outside "
            "its interval; log pressures too, and a motion that never repeats; try more starts"
        )
    if whole_loop and REFERENCE in logged:
        try:
            model = compilation.compile(start)
            whole = identify(model, part, unknowns, at=_at(model, start, names), **options)
        except KneexoError as error:
            notes.append(f"without the whole loop: {error}")
    rows = found.predicted[0]
    return FittedScenario(
        scenario.model_copy(update={"nominal": smooth.nominal}).changed(
            {path: found.values[path] for path in paths}
        ),
        os.path.basename(path),
        paths,
        time_s[-len(rows) :],
        {name: column[-len(rows) :] for name, column in values.items()},
        {name: rows[:, place] for place, name in enumerate(compared)},
        np.asarray(np.isfinite(found.residuals[0]).any(axis=1)),
        found,
        whole,
        tuple(notes),
    )


def unknown_of(scenario: Scenario, path: str, ends: tuple[float, float] | None = None) -> Unknown:
    """Return a number of a scenario as an unknown: in a range, or in a decade about its value.

    Raises `ParameterError` if the path is no real number of the scenario, or the range is not
    within the declared one.
    """
    if not has_path(scenario, path):
        scenario.changed({path: 1.0})  # its error says which names there are
    holder, _, last = path.rpartition(".")
    value, owner = value_at(scenario, path), value_at(scenario, holder) if holder else scenario
    if not isinstance(value, float):
        raise ParameterError(f"{path} = {shown(value)}: must be a real number with a range")
    field = type(owner).model_fields[last]
    return _ranged(path, value, ends, limits_of(field), allowed_range(field), unit_of(field))


def _ranged(
    name: str,
    value: float,
    ends: tuple[float, float] | None,
    limits: tuple[float, float],
    allowed: str,
    unit: str,
) -> Unknown:
    low, high = sorted((value / _DECADE, value * _DECADE))
    low, high = ends or (max(low, limits[0]), min(high, limits[1]))
    if not limits[0] <= low < high <= limits[1]:
        raise ParameterError(
            f"{name} = {value:g} {unit}: the range {low:g} … {high:g} must have low < high, and be "
            f"{allowed}; give one, such as {name}=LOW:HIGH"
        )
    return Unknown(name, low, high, value if low <= value <= high else None, unit)


def _unknown(scenario: Scenario, text: str, log: Log) -> Unknown:
    """Return the unknown that ``text``, NAME or NAME=LOW:HIGH, asks for."""
    name, _, words = text.partition("=")
    try:
        low, high = map(float, words.split(":")) if words or not name else (0.0, 0.0)
    except ValueError:
        raise ParameterError(
            f"parameters = {shown(text)!r}: must be NAME or NAME=LOW:HIGH"
        ) from None
    ends = (low, high) if words else None
    sensor, _, last = name.rpartition(".")
    if sensor not in log.measured or last not in _SENSOR:
        unknown = unknown_of(scenario, name, ends)
    else:
        value, unit = _SENSOR[last]
        unknown = _ranged(name, value, ends, (-math.inf, math.inf), "finite", unit)
    value = unknown.value(unknown.begin)
    if unknown.unit == "s" and value > (duration_s := float(np.ptp(log.time_s))):
        raise ParameterError(
            f"{name} = {value:g} s: is longer than the log of {duration_s:.4g} s; must be shorter; "
            f"take a longer log"
        )
    return unknown


def _started(
    smooth: Scenario, logged: Mapping[str, Array], theta_4: Array | None, time_s: Array
) -> Scenario:
    """Return the scenario that starts where the log starts, and follows the logged reference.

    ``theta_4`` are the angles of the encoder. Without a reference the knee starts at their first.
    """
    knee, link, offset_m = smooth.plant.knee, smooth.plant.linkage, 0.0
    start = start_angle_rad(smooth.reference)
    if theta_4 is not None:
        start = float(knee_angle_from_encoder(link, theta_4[0], eq6_sign(link)))
        start = float(np.clip(start, *np.radians((knee.flexion_min_deg, knee.flexion_max_deg))))
    times_s, reference = np.arange(3.0), np.full(3, start)
    if REFERENCE in logged:
        times_s, reference = time_s, logged[REFERENCE]
        ends = polynomial(controller_polynomial(smooth).p_si, np.array([reference[0], start]))
        offset_m = float(np.diff(ends)[0])
    samples = SampledReference(
        times_s=tuple(times_s.tolist()), angles_deg=tuple(np.degrees(reference).tolist())
    )
    return smooth.model_copy(update={"reference": samples, OFFSET: offset_m})


def _at(
    model: CompiledModel, start: Scenario, paths: Sequence[str], command: InputTable | None = None
) -> Callable[[Mapping[str, float], Log], tuple[Array, State, InputTable]]:
    """Return the function of the unknowns and of the log that `diagramc.identify` calls."""
    plant = plant_states(start)

    def at(values: Mapping[str, float], log: Log) -> tuple[Array, State, InputTable]:
        try:
            scenario = start.changed({path: values[path] for path in paths if path in values})
            parameters, state, inputs = scenario_run(scenario, model, command)
        except (ParameterError, LinkageError) as error:  # the search must turn back, not end
            raise SimulationError(str(error)) from None
        speed, x = log.measured.get("motor_speed", (0.0,))[0], state.continuous.copy()
        for place, name in enumerate(model.state_names):
            if name in plant and plant[name].column == SPEED:  # the log can begin in motion
                x[place] = speed / plant[name].factor
        return parameters, State(x, state.discrete), inputs

    return at
