"""Simulates many variants of a scenario in one call, with one row of metrics for each run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from os import PathLike
from pathlib import Path
from textwrap import indent
from typing import Any, Literal, overload

import numpy as np

from diagramc import write_files
from kneexo.analysis.tracking.reduced_tracking import track_metrics
from kneexo.analysis.tracking.tracking import TrackingMetrics
from kneexo.common.plotting import PURPLE, RED, axes_or_new
from kneexo.common.result import Result, data_frame
from kneexo.errors import ParameterError, close_names, failure_noted, question, shortened, shown
from kneexo.parameters import LawParameters, Scenario
from kneexo.parameters.paths import has_path
from kneexo.parameters.scenario_file import as_scenario, scenario_files
from kneexo.simulation import needs_runs
from kneexo.sweeps import parallel_map

METRICS = tuple(field.name for field in fields(TrackingMetrics))
"""Names of the metrics of each run, the fields of `TrackingMetrics`."""

MOST_RUNS = 1_000_000
"""Largest number of runs in a batch."""

_EXAMPLE = "{'plant.cylinder.mass_kg': [1.4, 1.8]}"


@dataclass(frozen=True, repr=False)
class BatchRow(Result):
    """One run of a batch.

    ``values`` maps the path of each changed value to the value of this run. A run that succeeds has
    ``metrics``, and its ``error`` is an empty text. A run that fails has no ``metrics`` (None), and
    its ``error`` is the reason in one line. If the values make no valid scenario, ``scenario`` is
    None.
    """

    values: Mapping[str, Any]
    scenario: Scenario | None
    metrics: TrackingMetrics | None
    error: str

    def write_failure(self, path: str | PathLike[str]) -> None:
        """Write the scenario of the failed run to a file, such as ``failure_1.yaml``.

        ``kneexo simulate failure_1.yaml --out DIR`` repeats the run, which ends with the same
        error. The files of a control law of yours are copied beside the file. Raises
        `ParameterError` if the run has not failed, if the scenario refuses the values, or if the
        control law has no name in a file, such as a lambda. Raises `OutputError` if a file cannot
        be written.
        """
        if not self.error:
            raise ParameterError("the run of this row has not failed")
        if self.scenario is None:
            raise ParameterError(f"there is no run: the scenario refuses the values: {self.error}")
        if isinstance(controller := self.scenario.controller, LawParameters):
            controller.function.require_name()
        file = Path(path)
        files = scenario_files(self.scenario, file.name, file.parent)
        write_files(file.parent, files, f"file {shown(file)}")

    def __str__(self) -> str:
        """Return the changed values as text, a line for each."""
        return "\n".join(f"{path} = {_short(value)}" for path, value in self.values.items())


@dataclass(frozen=True, repr=False)
class BatchResult(Result):
    """The runs of a batch, one `BatchRow` for each run. ``print`` shows a summary."""

    rows: tuple[BatchRow, ...]

    @property
    def failures(self) -> tuple[BatchRow, ...]:
        """The rows of the runs that failed."""
        return tuple(row for row in self.rows if row.error)

    @overload
    def worst(self, metric: str = ..., count: None = None) -> BatchRow: ...

    @overload
    def worst(self, metric: str = ..., *, count: int) -> tuple[BatchRow, ...]: ...

    @overload
    def worst(self, metric: str, count: int) -> tuple[BatchRow, ...]: ...

    def worst(
        self, metric: str = "max_error_deg", count: int | None = None
    ) -> BatchRow | tuple[BatchRow, ...]:
        """Return the row with the largest value of a metric among the runs that succeed.

        ``metric`` is one of `METRICS`. With ``count`` return the ``count`` rows with the largest
        values, the largest first, or all rows if fewer runs have a value. Raises `ParameterError`
        for another metric, a ``count`` below 1, and if no run has a value of the metric.
        """
        if count is not None and not (isinstance(count, int) and count >= 1):
            raise ParameterError(f"count = {count!r}: must be a whole number >= 1")
        if metric not in METRICS:
            advice = question(close_names(metric, METRICS))
            known = f"must be one of {', '.join(METRICS)}{advice}"
            raise ParameterError(f"metric = {metric!r}: {known}")
        finite = [row for row in self.rows if not math.isnan(_value(row, metric))]
        if not finite:
            raise ParameterError(
                f"{metric}: all {len(self.rows)} runs fail; the first: {self.rows[0].error}"
            )
        finite.sort(key=lambda row: _value(row, metric), reverse=True)
        return finite[0] if count is None else tuple(finite[:count])

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` with a row for each run.

        The columns are the paths of the changed values, the `METRICS` and ``error``. For a failed
        run the metrics are ``<NA>``, and ``error`` is the reason. For the other runs ``error`` is
        an empty text. Raises `PackageError` without pandas.
        """
        columns: dict[str, list[Any]] = {
            path: [row.values[path] for row in self.rows] for path in self.rows[0].values
        }
        for name in METRICS:
            columns[name] = [getattr(row.metrics, name, None) for row in self.rows]
        columns["error"] = [row.error for row in self.rows]
        return data_frame(columns).astype(dict.fromkeys(METRICS, "Float64"))

    def plot(self, ax: Any = None) -> Any:
        """Plot the largest error of each run; return the Matplotlib axes.

        The horizontal axis shows the changed value if only one value changes and it is a number,
        else the number of the run. A failed run is a red cross at zero.
        """
        ax = axes_or_new(ax, caption="Largest error of each run.", figsize=(7, 3))
        x, label = np.arange(1.0, 1.0 + len(self.rows)), "run"
        (path, first), *others = self.rows[0].values.items()
        if not others and isinstance(first, int | float):
            x, label = np.array([row.values[path] for row in self.rows], dtype=float), path
        error = np.array([_value(row, "max_error_deg") for row in self.rows])
        ax.plot(x, error, "o", color=PURPLE, ms=4, label="largest error")
        if failed := [n for n, row in enumerate(self.rows) if row.error]:
            ax.plot(x[failed], np.zeros(len(failed)), "x", color=RED, label="failed")
            ax.legend()
        ax.set(xlabel=label, ylabel="largest error (deg)")
        return ax

    def __str__(self) -> str:
        """Return the number of runs, the largest error and its values, and the first failure."""
        count = len(self.rows)
        lines = [f"{count} run{'s' if count > 1 else ''}, {len(self.failures)} failed"]
        if len(self.failures) < count:
            row = self.worst()
            lines.append(f"  largest max_error_deg {_value(row, 'max_error_deg'):.4g} at")
            lines += indent(str(row), "    ").splitlines()
        if self.failures:
            row = self.failures[0]
            lines.append("  first failure at")
            lines += indent(f"{row}\n{row.error}", "    ").splitlines()
        return "\n".join(lines)


def _value(row: BatchRow, metric: str) -> float:
    """Return a metric of a run; nan if the run failed."""
    return float(getattr(row.metrics, metric, math.nan))


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else shortened(repr(value), 60)


def batch(
    scenario: Scenario | str | PathLike[str],
    values: Mapping[str, Sequence[Any]],
    *,
    combine: Literal["grid", "zip"] = "grid",
    law: Any = None,
    initial_state: Sequence[float] = (),
    workers: int | None = 1,
    progress: bool = True,
) -> BatchResult:
    """Simulate a scenario with many values, such as 500 masses, and return the metrics of each run.

    Runs of scenarios that differ only in numbers share batches of the compiled engine. A run that
    fails does not stop the others: its row has the reason.

    A changed value of ``plant`` changes the plant that the controller believes in too. To vary the
    plant alone, fix the controller's plant: ``scenario.changed({"nominal": scenario.plant})``.

    Parameters
    ----------
    scenario
        A scenario, or the path of a scenario file.
    values
        Dictionary from the dotted path of a value, such as ``"plant.cylinder.mass_kg"``, to the
        values that it takes, a list or array. ``kneexo params`` lists the paths.
    combine
        ``"grid"``: every combination of the values, where the last path varies fastest. ``"zip"``:
        run number k takes the value number k of each path, for example of random samples.
    law, initial_state
        A control law that replaces the law of the scenario: see `Scenario.with_law`. Its gains are
        at paths such as ``"controller.values.gain"``.
    workers
        Number of processes. None: one process for each core. Processes are spawned, so a script
        needs ``if __name__ == "__main__":`` unless this is 1.
    progress
        Whether a progress bar with the remaining time is shown in a terminal or notebook.

    Raises
    ------
    ParameterError
        The scenario lacks a path, a list is empty, the lists have unequal lengths with ``"zip"``,
        or the number of runs or of ``workers`` is out of range.

    Examples
    --------
    >>> import kneexo as kx
    >>> gains = {"controller.lambda_per_s": [10.0, 20.0, 40.0]}
    >>> for row in kx.batch(kx.Scenario(), gains, progress=False).rows:
    ...     print(row, f"-> largest error {row.metrics.max_error_deg:.2f} deg")
    controller.lambda_per_s = 10 -> largest error 0.23 deg
    controller.lambda_per_s = 20 -> largest error 0.05 deg
    controller.lambda_per_s = 40 -> largest error 0.03 deg
    """
    scenario = as_scenario(scenario, law, initial_state)
    if not isinstance(values, Mapping):
        raise ParameterError(
            f"values: must map paths to lists, as {_EXAMPLE}, not be a {type(values).__name__}"
        )
    lists = {path: _listed(scenario, path, items) for path, items in values.items()}
    rows = [_not_run(scenario, combination) for combination in _combinations(lists, combine)]
    outcomes = iter(
        parallel_map(
            _metrics_or_error,
            [row.scenario for row in rows if row.scenario is not None],
            workers=workers,
            description="batch" if progress else None,
            weight=lambda variant: variant.duration_s,
        )
    )
    return BatchResult(
        tuple(row if row.scenario is None else replace(row, **next(outcomes)) for row in rows)
    )


def _listed(scenario: Scenario, path: str, values: Any) -> list[Any]:
    """Return the values of a path as a list; raise `ParameterError` if the argument is faulty."""
    if not isinstance(path, str):
        raise ParameterError(f"values: the path {path!r} must be a text, as {_EXAMPLE}")
    if isinstance(values, str | bytes | Mapping) or not np.iterable(values):
        raise ParameterError(f"{path} = {_short(values)}: must be a list of values")
    items = [v.tolist() if isinstance(v, np.generic | np.ndarray) else v for v in values]
    if not items:
        raise ParameterError(f"{path}: must have at least one value, not an empty list")
    if not has_path(scenario, path):
        scenario.changed({path: items[0]})  # raises the error; a path into a mapping is allowed
    return items


def _combinations(lists: Mapping[str, list[Any]], combine: str) -> Iterator[dict[str, Any]]:
    """Yield the changed values of each run; raise `ParameterError` if there are none or too many.

    `batch` describes ``combine``.
    """
    lengths = {path: len(items) for path, items in lists.items()}
    if not lists:
        raise ParameterError("values: must name at least one value to change")
    if combine == "zip":
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{path} has {length}" for path, length in lengths.items())
            raise ParameterError(f"combine = 'zip': needs lists of equal length, but {counts}")
        combinations: Any = zip(*lists.values(), strict=True)
        count = min(lengths.values())
    elif combine == "grid":
        combinations, count = product(*lists.values()), math.prod(lengths.values())
    else:
        raise ParameterError(f"combine = {combine!r}: must be 'grid' or 'zip'")
    if count > MOST_RUNS:
        raise ParameterError(f"values: give {count} runs, must be at most {MOST_RUNS}")
    return (dict(zip(lists, combination, strict=True)) for combination in combinations)


def _not_run(scenario: Scenario, values: dict[str, Any]) -> BatchRow:
    """Return the row of a run before it begins, with the error of values that are refused."""
    made: dict[str, Any] = {"scenario": None}
    with failure_noted(made, "error"):
        made["scenario"] = scenario.changed(values)
    return BatchRow(values, metrics=None, **made)


@needs_runs
def _metrics_or_error(scenario: Scenario) -> dict[str, Any]:
    """Return ``metrics`` and ``error`` of a run, as in `BatchRow`."""
    outcome: dict[str, Any] = {"metrics": None}
    with failure_noted(outcome, "error"):
        outcome["metrics"] = track_metrics(scenario)
    return outcome
