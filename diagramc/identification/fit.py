"""Finds unknowns of a compiled model from logs of a machine: `identify`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.optimize
import scipy.stats

from ..arguments import quoted
from ..errors import Error, ParameterError, SimulationError, shown
from ..model import CompiledModel, DiagramModel
from ..native.runner import output_elements
from ..run_data import Array, InputTable, State
from .log import Log, Unknown, segments_of
from .prediction import SENSOR, At, Prediction
from .trust import (
    SCORES,
    combinations,
    covariance_of,
    input_correlation,
    stacked,
    whiteness,
    without_effect,
)

_MOVED = 0.01  # of the range: least_squares starts off the bounds, where its scales are not zero
_AT_BOUND = 1e-4  # of the range
_CONFIDENCE = 0.95
_ALIKE = 0.95  # correlation of two unknowns that a note names
_FOLLOWS = 0.25  # neighbouring lags are alike, so with 5 % expected a tenth is no rarity
_LEAST_NOISE = 1e-9  # in spreads: that of the runs themselves
_RESTARTS = 5  # at most, from places whose misfit is lower by
_LOWER = 0.5  # which is one standard deviation
_RIDGE = 0.5  # growth of the misfit, by that of a smooth model, from which on an interval holds
_LEAST_RIDGE = 0.04  # intervals become five times as wide at most
_REWEIGHTED = 10  # at most, until the noise changes by less than 1 %


class _Problem:
    """Least squares of the residuals of a prediction, weighted by the noise of each output."""

    def __init__(self, prediction: Prediction, loss: str) -> None:
        """Begin with the noise that the measured values show.

        Their third differences have 20 times the variance of white noise, and hardly a smooth
        motion. With the spread in place of the noise, searches ended in wrong minima: an output
        that hardly moves weighed too much.
        """
        self.prediction, self.loss = prediction, loss
        segments = prediction.segments
        self.used = [np.isfinite(s.measured) & s.trained[:, None] for s in segments]
        spread = np.nanstd(np.concatenate([s.measured for s in segments]), axis=0)
        self.spread = np.where(spread > 0.0, spread, 1.0)
        thirds = [[np.diff(y[np.isfinite(y)], n=3) for y in s.measured.T] for s in segments]
        columns = [np.concatenate(pieces) for pieces in zip(*thirds, strict=True)]
        variance = [np.sum(third**2) / 20.0 / max(third.size, 1) for third in columns]
        self.noise = np.maximum(np.sqrt(variance), _LEAST_NOISE * self.spread)
        self.rows = int(sum(used.sum() for used in self.used))

    def residuals(self, z: Array) -> list[Array]:
        """Return predicted less measured values (rows, elements); nan: not used in the fit."""
        predicted = self.prediction.predict(z)
        cases = zip(predicted, self.prediction.segments, self.used, strict=True)
        return [np.where(used, p - s.measured, np.nan) for p, s, used in cases]

    def jacobian(self, z: Array, *, rough: bool = False) -> list[Array]:
        """Return the weighted Jacobian (rows, elements, columns), zero where a row is not used."""
        jacobian = self.prediction.slopes(z) if rough else self.prediction.jacobian(z)
        noise = self.noise[:, None]
        return [
            np.where(used[:, :, None], piece / noise, 0.0)
            for piece, used in zip(jacobian, self.used, strict=True)
        ]

    def costs(self, zs: Array) -> Array:
        """Return half the sum of the weighted squares of each z; infinite where a run fails."""
        costs = np.zeros(len(zs))
        for index, (segment, used) in enumerate(
            zip(self.prediction.segments, self.used, strict=True)
        ):
            for place, run in enumerate(self.prediction.predictions(index, [*zs])):
                if isinstance(run, Error):
                    costs[place] = np.inf
                else:
                    errors = (run - segment.measured) / self.noise
                    costs[place] += 0.5 * np.sum(errors[used] ** 2)
        return costs

    def solve(self, z: Array, free: Any = slice(None)) -> Any:
        """Minimize over the ``free`` unknowns from z; ``x`` of the result has all unknowns."""
        used = np.concatenate([piece.ravel() for piece in self.used])

        def whole(places: Array) -> Array:
            moved = z.copy()
            moved[free] = places
            return moved

        def weighted(places: Array) -> Array:
            try:
                residuals = np.concatenate(self.residuals(whole(places))) / self.noise
            except SimulationError:  # a step too far: the trust region shrinks
                return np.full(self.rows, np.inf)
            return residuals.ravel()[used]

        def slopes(places: Array) -> Array:
            return stacked(self.jacobian(whole(places), rough=True))[used][:, free]

        self.residuals(z)  # a failure at the start is the caller's to know
        if not z[free].size:
            errors = weighted(z[free])
            return scipy.optimize.OptimizeResult(x=z, cost=0.5 * float(errors @ errors))
        result = scipy.optimize.least_squares(
            weighted, z[free], slopes, bounds=(0.0, 1.0), x_scale="jac", loss=self.loss, xtol=1e-10
        )
        result.x = whole(result.x)
        return result

    def fit(self, z: Array) -> Any:
        """Minimize over all unknowns, and again with the noise that the residuals show."""
        for _ in range(_REWEIGHTED):
            result = self.solve(z)
            z, before = result.x, self.noise
            errors = np.concatenate(self.residuals(z))
            if self.loss == "linear":
                freedom = self.rows / (self.rows - z.size)
                noise = np.sqrt(np.nanmean(errors**2, axis=0) * freedom)
            else:  # the median of outliers is that of the noise
                noise = 1.4826 * np.nanmedian(np.abs(errors), axis=0)
            self.noise = np.maximum(noise, _LEAST_NOISE * self.spread)
            if np.all(np.abs(self.noise / before - 1.0) < 0.01):
                break
        return result


@dataclass(frozen=True, repr=False)
class Fit:
    """The result of `identify`; ``str`` gives a table with notes. Intervals are of 95 %."""

    unknowns: tuple[Unknown, ...]
    names: tuple[str, ...]
    """Names of the unknowns. An initial state has one for each segment, if there are several."""
    values: dict[str, float]
    interval: dict[str, tuple[float, float]]
    """Interval of each unknown, at most its range."""
    words: dict[str, str]
    """``bounded``: the interval is inside the range. ``one-sided``: it ends at one end of the
    range. ``flat``: it covers the range. ``several minima``: the search from another start ended
    outside the interval, with as small an error."""
    covariance: Array
    """Covariance of the values, (n, n), to first order."""
    noise: dict[str, float]
    """Standard deviation of the noise of each measured output."""
    correlation_time_s: dict[str, float]
    """Integrated autocorrelation time of the residuals; of white noise the sample time."""
    train: dict[str, float]
    """Share of each output that the fit explains, 100 (1 − ‖r‖/‖y − mean y‖) in %."""
    validation: dict[str, float]
    """The same for the rows that took no part in the fit, empty without such rows."""
    residuals: tuple[Array, ...]
    """Predicted less measured values (rows, elements) of each segment."""
    whiteness: dict[str, float]
    """p-value of the test by Ljung and Box for white residuals of each output."""
    notes: tuple[str, ...]
    _problem: _Problem = field(repr=False)
    _z: Array = field(repr=False)
    _widening: Array = field(repr=False)

    @property
    def correlation(self) -> Array:
        """Correlation of the values, (n, n)."""
        deviation = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(deviation, deviation)

    @property
    def predicted(self) -> tuple[Array, ...]:
        """Predicted values (rows, elements) of each segment, also in rows held out."""
        return tuple(self._problem.prediction.predict(self._z))

    def profile(self, name: str) -> tuple[float, float]:
        """Return the interval of an unknown by the profile of its likelihood.

        The other unknowns are fitted anew at each value. The interval ends where the sum of the
        weighted squares has grown by 1.96², times the ratio of the variance to that with white
        noise, or at the end of the range. Raises `ParameterError` for an unknown name.
        """
        _require_known("unknown", [name], self.names)
        c = self.names.index(name)
        free = np.arange(len(self.names)) != c
        z = self._z.copy()
        allowed = 0.5 * scipy.stats.chi2.ppf(_CONFIDENCE, 1) * self._widening[c]
        allowed += self._problem.solve(z, free).cost

        def excess(place: float) -> float:
            z[c] = place
            return float(self._problem.solve(z, free).cost - allowed)

        low, high = (
            scipy.optimize.brentq(excess, end, self._z[c], rtol=1e-4) if excess(end) > 0.0 else end
            for end in (0.0, 1.0)
        )
        return self.unknowns[c].value(low), self.unknowns[c].value(high)

    def __str__(self) -> str:
        """Return a table with a line for each unknown, the scores, and the notes."""
        rows = [("unknown", "value", "± (95 %)", "unit", "")]
        for unknown, name in zip(self.unknowns, self.names, strict=True):
            low, high = self.interval[name]
            half = f"{0.5 * (high - low):.2g}"
            rows.append((name, f"{self.values[name]:.5g}", half, unknown.unit, self.words[name]))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        for output, percent in self.train.items():
            held = self.validation.get(output)
            rest = "" if held is None else f" of the rows fitted, {held:.2f} % of those held out"
            lines.append(f"{output}: the model explains {percent:.2f} %{rest}")
        return "\n".join([*lines, *self.notes])


def identify(
    model: CompiledModel,
    logs: Sequence[Log] | Log,
    unknowns: Sequence[Unknown],
    *,
    parameters: Array | None = None,
    state: State | None = None,
    at: At | None = None,
    validation: float | None = None,
    held_out: Sequence[Log] = (),
    loss: str = "linear",
    starts: int = 1,
    seed: int = 0,
    **options: Any,
) -> Fit:
    """Fit unknowns of a model to logs, and say how far to trust each value.

    The model runs from the machine's samples at the start of each segment to the stamps of the log,
    open loop. The sum of the squared differences, or of another loss, is minimized by SciPy's
    ``least_squares`` within the ranges. Each output is weighted by its noise: the root mean square
    of its residuals, found again until it settles. With another loss than ``linear`` the noise
    comes from the median.

    A sensor shows gain · y(t − delay) + bias of an output y.

    Parameters
    ----------
    model
        The compiled model. Its open inputs are the commands of the log.
    logs
        One log or several. A hole of more than ten sample times divides a log into segments.
    unknowns
        What to find. An initial state has a value of its own in each segment.
    parameters, state
        Values of what is not unknown, and of the state at the start of each segment; by default
        those of the diagram.
    at
        In place of ``parameters`` and ``state``, a function of the unknowns by name and of the log.
        It returns parameters, initial state and inputs of a run, in the time of the log.
    validation
        Share at the end of each segment that takes no part in the fit: by default a quarter, or
        nothing with ``held_out``.
    held_out
        Logs that take no part in the fit. Only their own initial states are fitted to them.
    loss
        ``linear``, or for outliers ``huber``, ``soft_l1`` or ``cauchy``.
    starts, seed
        Number of starts. The first is that of the unknowns, the others are a Latin hypercube whose
        seed is ``seed``.
    options
        ``integrator``, ``tolerance``, ``step_s`` and ``threads`` as in `CompiledModel.simulate`.

    Raises
    ------
    ParameterError
        An unknown or a column is not of the model, has no effect, or the log is too short.
    SimulationError
        The run at the start fails.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    if validation is None:
        validation = 0.0 if held_out else 0.25
    if not logs or not unknowns or loss not in SCORES or not 0.0 <= validation < 1.0:
        raise ParameterError(
            f"identify: needs a log, an unknown, 0 <= validation < 1, and a loss of "
            f"{', '.join(SCORES)}"
        )
    elements = list(dict.fromkeys(name for log in logs for name in log.measured))
    outputs = [name for name, _ in output_elements(model.outputs)]
    states = {*model.state_names, *model.discrete_names}
    sensors = [f"{element}.{kind}" for element in elements for kind in SENSOR]
    asked = [unknown.name for unknown in unknowns]
    for log in (*logs, *held_out):
        _require_known("output", log.measured, outputs)
    if at is None:
        _require_known("unknown", asked, [*sensors, *model.parameter_names, *states])
        at = _given(model, (*logs, *held_out), parameters, state)
    if twice := [n for n in asked if [*asked, *{*sensors} & {*model.parameter_names}].count(n) > 1]:
        raise ParameterError(f"{quoted(twice[0])}: is listed twice, or has two meanings")
    longest = max((u.high for u in unknowns if u.name in sensors and "delay" in u.name), default=0)
    segments = segments_of(logs, elements, longest, validation)
    if len(segments) > len(logs) and states.isdisjoint(asked):
        raise ParameterError(
            "log: has a hole of more than ten sample times; add the initial states to the unknowns"
        )
    notes: list[str] = []
    problem = _Problem(Prediction(model, segments, elements, unknowns, at, options), loss)
    start = _start(problem, notes)
    best, ridges, others = _search(problem, start, starts, seed, notes)
    fit = _trusted(problem, best, ridges, others, notes)
    if not held_out:
        return fit
    rest = segments_of(held_out, elements, longest, 0.0)
    initial = [unknown for unknown in unknowns if unknown.name in states]
    fixed = {name: value for name, value in fit.values.items() if name in asked}
    other = _Problem(Prediction(model, rest, elements, initial, at, options, fixed), loss)
    other.noise = problem.noise
    z = np.array([unknown.begin for unknown in other.prediction.unknowns])
    return replace(fit, validation=_explained(other, other.solve(z).x, trained=True))


def sensitivities(
    model: CompiledModel,
    logs: Sequence[Log] | Log,
    unknowns: Sequence[Unknown],
    *,
    parameters: Array | None = None,
    state: State | None = None,
    at: At | None = None,
    **options: Any,
) -> list[Array]:
    """Return how much what logs show changes with unknowns, to judge an experiment beforehand.

    The result has an array (rows, elements, unknowns) for each segment: the derivatives J by the
    place of each unknown in its range, `Unknown.place`. With the noise σ of each element the
    information about the places is Σ JᵀJ/σ².

    Parameters
    ----------
    model, logs
        The compiled model, and logs of which times and inputs matter. The elements have the order
        of ``measured``, whose values do not matter.
    unknowns
        Numbers that have their starts.
    parameters, state, at, options
        As in `identify`.

    Raises
    ------
    ParameterError
        An output or unknown is not of the model.
    SimulationError
        A run fails.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    elements = list(dict.fromkeys(name for log in logs for name in log.measured))
    _require_known("output", elements, [name for name, _ in output_elements(model.outputs)])
    at = _given(model, logs, parameters, state) if at is None else at
    longest = max((u.high for u in unknowns if u.name.endswith(".delay_s")), default=0.0)
    segments = segments_of(logs, elements, longest, 0.0)
    prediction = Prediction(model, segments, elements, unknowns, at, options)
    return prediction.jacobian(np.array([unknown.begin for unknown in prediction.unknowns]))


def _require_known(kind: str, names: Iterable[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise ParameterError(f"{kind} {quoted(name)}: must be one of {shown(', '.join(known))}")


def _start(problem: _Problem, notes: list[str]) -> Array:
    """Return the start, and note what the log cannot tell there; refuse what has no effect."""
    names, unknowns = problem.prediction.names, problem.prediction.unknowns
    given = np.array([unknown.begin for unknown in unknowns])
    if problem.rows <= 2 * given.size:
        raise ParameterError(
            f"log: has {problem.rows} values for {given.size} unknowns: must have more than twice "
            f"as many"
        )
    start = np.clip(given, _MOVED, 1.0 - _MOVED)
    for name, unknown, place, before in zip(names, unknowns, start, given, strict=True):
        if before in (0.0, 1.0):
            notes.append(f"{name}: the start moved off its bound to {unknown.value(place):.5g}")
    first = stacked(problem.jacobian(start))
    if idle := without_effect(first, names):
        raise ParameterError(
            f"{', '.join(idle)}: has no effect on a measured output at the start; start "
            f"elsewhere, leave out, or measure more"
        )
    notes += combinations(first, names, unknowns)
    return start


def _given(
    model: CompiledModel, logs: Sequence[Log], parameters: Array | None, state: State | None
) -> At:
    """Return the function that sets unknowns in given parameters, or in those of the diagram."""
    if isinstance(model, DiagramModel):
        parameters = model.parameters() if parameters is None else parameters
        state = model.state() if state is None else state
    if parameters is None or state is None:
        raise ParameterError("identify: a model without its diagram needs parameters and state")
    tables = {id(log): log.table(model.inputs) for log in logs}
    places = {name: place for place, name in enumerate(model.parameter_names)}

    def at(values: Mapping[str, float], log: Log) -> tuple[Array, State, InputTable]:
        changed = np.array(parameters, dtype=float)
        for name, value in values.items():
            if name in places:
                changed[places[name]] = value
        return changed, state, tables[id(log)]

    return at


def _search(
    problem: _Problem, start: Array, starts: int, seed: int, notes: list[str]
) -> tuple[Any, Array, list[Any]]:
    """Return the best minimum, its ridges, and the minima from all starts that are as good.

    All starts but the first have the weights that the first has found.
    """
    found = [problem.fit(start)]
    sampler = scipy.stats.qmc.LatinHypercube(start.size, seed=seed)
    for number, z in enumerate(sampler.random(starts - 1), 2):
        try:
            found.append(problem.solve(z))
        except SimulationError as error:
            notes.append(f"search {number} of {starts} failed: {error}")
    best = min(found, key=lambda result: float(result.cost))
    best, ridges = _settled(problem, best if best is found[0] else problem.fit(best.x))
    alike = [problem.solve(each.x) for each in (best, *found) if starts > 1]  # with one weight
    equal = 0.5 * scipy.stats.chi2.ppf(_CONFIDENCE, 1)
    return best, ridges, [each for each in alike if each.cost < alike[0].cost + equal]


def _settled(problem: _Problem, best: Any) -> tuple[Any, Array]:
    """Go on from a lower place nearby while there is one; return the result and its ridges.

    Each unknown is moved by two standard deviations to both sides, and the others follow. Where the
    outputs have kinks, as with friction, ``least_squares`` stops before the minimum. The ridges
    (unknowns,) are the least growth of the misfit there, divided by that of a smooth model. After
    the last restart they are those of the place before, where they are below zero.
    """
    ridges = np.ones(2 * best.x.size)
    for _ in range(_RESTARTS if problem.loss == "linear" else 0):  # whose costs these are
        z, jacobian = best.x, stacked(problem.jacobian(best.x))
        inverse = np.linalg.pinv(jacobian)
        covariance = inverse @ inverse.T
        # Columns of the covariance are the ways on which the misfit grows least.
        moves = 2.0 * covariance / np.sqrt(np.diag(covariance))[:, None]
        ends = np.clip(z + np.concatenate([moves, -moves]), 0.0, 1.0)
        expected = 0.5 * np.sum(((ends - z) @ jacobian.T) ** 2, axis=1)
        costs = problem.costs(np.concatenate([z[None], ends]))
        grown = costs[1:] - costs[0]
        ridges = np.divide(grown, expected, np.ones(grown.size), where=expected > _LOWER)
        if grown.min() > -_LOWER:
            break
        best = problem.fit(ends[np.argmin(grown)])
    return best, np.min(ridges.reshape(2, -1), axis=0)


def _trusted(
    problem: _Problem, best: Any, ridges: Array, others: Sequence[Any], notes: list[str]
) -> Fit:
    """Return the fit with intervals, a word for each unknown, scores and tests of residuals."""
    prediction, z = problem.prediction, best.x
    names, unknowns = prediction.names, prediction.unknowns
    residuals = problem.residuals(z)
    weighted = [piece / problem.noise for piece in residuals]
    covariance, white, times = covariance_of(problem.jacobian(z), weighted, problem.loss)
    # Correlation only widens: residuals that swing about zero, as counts of a slow motion do, would
    # make intervals narrower than those of white noise, and they are no noise.
    wider = np.sqrt(np.maximum(np.diag(white) / np.diag(covariance), 1.0))
    for place, ridge in enumerate(ridges.tolist()):
        if ridge >= _RIDGE:
            continue
        factor = max(ridge, _LEAST_RIDGE) ** -0.5
        wider[place] *= factor
        notes.append(
            f"{names[place]}: two standard deviations away the misfit grows {ridge:.2g} times as "
            f"much as expected (kinks, curvature or other minima): the interval is a guess, "
            f"{factor:.2g} times as wide"
        )
    covariance = covariance * np.outer(wider, wider)
    deviation = np.sqrt(np.diag(covariance))
    counts = np.sum([used.sum(axis=0) for used in problem.used], axis=0)
    freedom = max(float(np.sum(counts / np.maximum(times, 1.0))) - z.size, 1.0)
    one, two = (scipy.stats.t.ppf(p, freedom) for p in (_CONFIDENCE, 0.5 + 0.5 * _CONFIDENCE))
    interval, words = {}, {}
    for c, name in enumerate(names):
        low, high = z[c] - two * deviation[c], z[c] + two * deviation[c]
        if z[c] < _AT_BOUND:
            low, high = 0.0, z[c] + one * deviation[c]
        elif z[c] > 1.0 - _AT_BOUND:
            low, high = z[c] - one * deviation[c], 1.0
        inside = int(low > 0.0) + int(high < 1.0)
        words[name] = ("flat", "one-sided", "bounded")[inside]
        if any(not low <= other.x[c] <= high for other in others):
            words[name] = "several minima"
        ends = np.clip((low, high), 0.0, 1.0)
        interval[name] = unknowns[c].value(ends[0]), unknowns[c].value(ends[1])
    correlation = covariance / np.outer(deviation, deviation)
    for a, b in zip(*np.nonzero(np.triu(np.abs(correlation) > _ALIKE, 1)), strict=True):
        notes.append(
            f"{names[a]} and {names[b]}: the log hardly tells them apart (correlation "
            f"{correlation[a, b]:.3f})"
        )
    values = {n: u.value(p) for n, u, p in zip(names, unknowns, z, strict=True)}
    slope = np.array([u.slope(v) for u, v in zip(unknowns, values.values(), strict=True)])
    times_s = times * prediction.segments[0].log.sample_time_s
    commands = [
        np.array([*map(prediction.case(i, z)[2].value, segment.time_s)])
        for i, segment in enumerate(prediction.segments)
    ]
    white_p = {}
    for element, name in enumerate(prediction.elements):
        used = np.concatenate(problem.used)[:, element]
        column = np.concatenate(weighted)[used, element]
        largest, lag, white_p[name] = whiteness(column)
        if white_p[name] < 1.0 - _CONFIDENCE:
            notes.append(
                f"{name}: the residuals are not white (p = {white_p[name]:.2g}; autocorrelation "
                f"{largest:.2f} at lag {lag}, ±{1.96 / column.size**0.5:.2g} if white): the noise "
                f"is coloured, the model lacks something, or a wrong minimum was found; "
                + (
                    f"correlation time {times_s[element]:.2g} s, so the intervals count "
                    f"{column.size} values as {column.size / times[element]:.0f}"
                    if times[element] > 1.0
                    else "neighbours have opposite signs, so the intervals are those of white noise"
                )
            )
        for (source, _), u in zip(
            output_elements(prediction.model.inputs), np.concatenate(commands)[used].T, strict=False
        ):
            if (share := input_correlation(column, u)) > _FOLLOWS:
                notes.append(
                    f"{name}: the residuals follow {source}: {100.0 * share:.0f} % of the "
                    f"correlations are beyond 1.96 σ (5 % expected); the model lacks something, "
                    f"a wrong minimum was found, or "
                    f"a controller returns coloured noise into {source}"
                )
    noise, correlation_time_s = (
        dict(zip(prediction.elements, numbers.tolist(), strict=True))
        for numbers in (problem.noise, times_s)
    )
    return Fit(
        tuple(unknowns),
        tuple(names),
        values,
        interval,
        words,
        covariance * np.outer(slope, slope),
        noise,
        correlation_time_s,
        _explained(problem, z, trained=True),
        _explained(problem, z, trained=False),
        tuple(residuals),
        white_p,
        tuple(notes),
        problem,
        z,
        np.diag(covariance) / np.diag(white),
    )


def _explained(problem: _Problem, z: Array, *, trained: bool) -> dict[str, float]:
    """Return 100 (1 − ‖r‖/‖y − mean y‖) of each output over the rows in or out of the fit."""
    segments = problem.prediction.segments
    rows = [s.trained == trained for s in segments]
    measured = np.concatenate([s.measured[r] for s, r in zip(segments, rows, strict=True)])
    predicted = problem.prediction.predict(z)
    wrong = np.concatenate([p[r] for p, r in zip(predicted, rows, strict=True)]) - measured
    scores = {}
    for element, name in enumerate(problem.prediction.elements):
        y = measured[:, element]
        if np.isfinite(y).sum() > 1:
            spread = np.sqrt(np.nansum((y - np.nanmean(y)) ** 2)) or 1.0
            scores[name] = 100.0 * (1.0 - np.sqrt(np.nansum(wrong[:, element] ** 2)) / spread)
    return scores
