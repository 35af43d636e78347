"""Frequency response over amplitude and frequency, and what limits it where."""

from __future__ import annotations

import math
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from kneexo.analysis.bandwidth import (
    acceleration_bound_hz,
    follower_bandwidth_hz,
    follower_response,
    large_signal_bandwidth_hz,
    rod_amplitude_m,
    rod_limits,
    speed_limit_reached_hz,
)
from kneexo.analysis.checkpoint import Checkpoint
from kneexo.analysis.coroutines import Steps, steps
from kneexo.analysis.frequency_response import (
    MINUS_3_DB,
    estimate_sine,
    require_sampled,
    require_sine,
)
from kneexo.analysis.heat_map import cell_borders, heat_map, plain_ticks
from kneexo.analysis.markdown import number
from kneexo.analysis.parallel import parallel_map
from kneexo.analysis.plant_linearization import Complex
from kneexo.analysis.rate_limit import (
    rate_limit_bandwidth_hz,
    rate_limited_follower,
    rate_limited_gain,
)
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.simulation import Array, needs_runs
from kneexo.errors import LinearizationError, SimulationError
from kneexo.parameters import AmplitudeMapParameters, Scenario, SineEstimateParameters
from kneexo.result import Result, data_frame
from kneexo.scenario import changed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MINUS_3_DB = 20.0 * math.log10(MINUS_3_DB)
_RATIO_AT_MINUS_3_DB = 1.0 / (math.tau * rate_limit_bandwidth_hz(1.0, 1.0))  # ρ = 0.55539
_LEAST_GAIN = 1e-12  # as of a sine between two counts of the encoder
_WANDERING_DEG = 1.0
_TICKS_HZ = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_LIMITS = {
    "follower_hz": "speed limit",
    "acceleration_bound_hz": "acceleration limit",
    "linear_loop_hz": "linear loop",
}

CELL = {
    "uncertainty": math.nan,
    "settled": False,
    "cycles": 0,
    "mean_deg": math.nan,
    "speed_limited_share": math.nan,
    "acceleration_limited_share": math.nan,
}
"""What a cell of the map holds besides the response (see `SineEstimate`), where its run failed."""


@dataclass(frozen=True, repr=False)
class AmplitudeMap(Result):
    """Response θ_p/θ_d of the fundamental over m amplitudes and n frequencies, by sinestream.

    ``response`` complex (m, n); ``cells`` (m, n) by the names of `CELL`. What failed is nan, and
    ``failures`` says why, a line each.

    ``bandwidths`` (m,) by name, in Hz: ``measured_hz`` (`large_signal_bandwidth_hz`), and what the
    limits alone say: ``linear_loop_hz``, ``acceleration_bound_hz``, ``follower_hz`` (speed limit,
    through x(θ)), ``rate_limit_hz`` (speed limit, closed form of a sine in x);
    ``speed_limit_reached_hz`` is where the reference begins to ask for more speed.

    ``linear`` (n,) is the response of the linear loop, ``follower`` (m, n) that of the follower.
    ``unquantized`` (n,) is measured at the smallest amplitude without the encoder's counts, and
    ``unlimited`` (n,) says where the motor was off its limits then.
    """

    amplitudes_deg: Array
    frequencies_hz: Array
    response: Complex
    cells: dict[str, Any]
    bandwidths: dict[str, Array]
    linear: Complex
    linear_failure: str
    """Why there is no linear loop; its response and bandwidth are nan then."""
    follower: Complex
    unquantized: Complex
    unlimited: Any
    failures: tuple[str, ...]
    scenario: Scenario
    settings: AmplitudeMapParameters

    @property
    def gain_db(self) -> Array:
        """Gain in dB, (m, n)."""
        return np.asarray(20.0 * np.log10(np.maximum(np.abs(self.response), _LEAST_GAIN)))

    @property
    def phase_deg(self) -> Array:
        """Phase in deg, unwrapped over frequency, (m, n)."""
        return np.array([_unwrapped_deg(row) for row in self.response])

    @property
    def relative_uncertainty(self) -> Array:
        """Uncertainty as a share of the gain, (m, n)."""
        return self.cells["uncertainty"] / np.maximum(np.abs(self.response), _LEAST_GAIN)

    def linear_deviation(self, *, quantized: bool) -> float:
        """Largest |G − G_linear|/|G_linear| at the smallest amplitude, with or without counts.

        Of the frequencies at which the motor stays off its limits; nan where there are none, or no
        linear loop.
        """
        measured = self.response[0] if quantized else self.unquantized
        deviation = np.abs(measured / self.linear - 1.0)[self.unlimited]
        return float(np.max(deviation)) if deviation.size else math.nan

    def decided_by(self, index: int) -> tuple[str, float]:
        """What predicts the lowest bandwidth of an amplitude, and that bandwidth in Hz."""
        predicted = {_LIMITS[name]: float(self.bandwidths[name][index]) for name in _LIMITS}
        name = min(predicted, key=lambda n: np.nan_to_num(predicted[n], nan=math.inf))
        return name, predicted[name]

    def to_dataframe(self) -> Any:
        """A row for each cell of the map, as `pandas.DataFrame`.

        Columns: ``amplitude_deg``, ``frequency_hz``, ``gain``, ``phase_deg`` and those of `CELL`.
        Raises `PackageError` without pandas.
        """
        amplitude, frequency = np.meshgrid(self.amplitudes_deg, self.frequencies_hz, indexing="ij")
        table = {
            "amplitude_deg": amplitude,
            "frequency_hz": frequency,
            "gain": np.abs(self.response),
            "phase_deg": self.phase_deg,
            **self.cells,
        }
        return data_frame({name: np.ravel(values) for name, values in table.items()})

    def results(self) -> dict[str, Any]:
        """Plain data: the linear loop, then the map by amplitude."""
        gain, phase = np.abs(self.response), self.phase_deg
        return {
            "frequencies_hz": self.frequencies_hz.tolist(),
            "linear_loop": {
                "gain": np.abs(self.linear).tolist(),
                "phase_deg": _unwrapped_deg(self.linear).tolist(),
                "failure": self.linear_failure,
                "largest_deviation": self.linear_deviation(quantized=True),
                "largest_deviation_without_quantizer": self.linear_deviation(quantized=False),
            },
            "amplitudes": [
                {
                    "amplitude_deg": float(amplitude),
                    "bandwidths": {n: float(v[i]) for n, v in self.bandwidths.items()},
                    "decided_by": self.decided_by(i)[0],
                    "gain": gain[i].tolist(),
                    "phase_deg": phase[i].tolist(),
                    **{name: values[i].tolist() for name, values in self.cells.items()},
                }
                for i, amplitude in enumerate(self.amplitudes_deg)
            ],
            "failures": list(self.failures),
        }

    # ------------------------------------------------------------------------------ report

    def report(self) -> str:
        """The story in Markdown."""
        unsettled = int(np.sum(~self.cells["settled"] & np.isfinite(self.gain_db)))
        worst = 100.0 * np.nanmax(self.relative_uncertainty, initial=0.0)
        lines = [
            "# Frequency response from small to large amplitudes",
            "",
            f"Sinestream about {require_sine(self.scenario).mean_deg:g}°, {self.response.size} "
            f"sines. Bandwidth is where the gain of the fundamental first falls below 1/√2. "
            f"{unsettled} sines had not settled after {self.settings.estimate.largest_cycles} "
            f"cycles: their scatter is in the uncertainty, which is at most {worst:.2g} % of the "
            f"gain.",
            "",
            "| amplitude (deg) | −3 dB, measured (Hz) | linear loop | acceleration bound "
            "| speed limit, follower | speed limit, closed form | lowest | measured / lowest |",
            "|---|---|---|---|---|---|---|---|",
        ]
        columns = ("linear_loop_hz", "acceleration_bound_hz", "follower_hz", "rate_limit_hz")
        for i, amplitude in enumerate(self.amplitudes_deg):
            name, expected = self.decided_by(i)
            measured = self.bandwidths["measured_hz"][i]
            values = [measured, *(self.bandwidths[column][i] for column in columns)]
            shown = " | ".join(number(value, ".4g") for value in values)
            lines.append(
                f"| {amplitude:g} | {shown} | {name} | {number(measured / expected, '.4g')} |"
            )
        lines += ["", self._limits_in_words(), "", self._linear_in_words()]
        if wandering := self._wandering_in_words():
            lines += ["", wandering]
        if self.failures:
            lines += ["", "Runs that failed:", "", *(f"- {line}" for line in self.failures)]
        return "\n".join(lines) + "\n"

    def _limits_in_words(self) -> str:
        at: dict[str, list[str]] = {}
        for i, amplitude in enumerate(self.amplitudes_deg):
            at.setdefault(self.decided_by(i)[0], []).append(f"{amplitude:g}°")
        parts = [f"the {name} at {', '.join(amplitudes)}" for name, amplitudes in at.items()]
        speed, acceleration = rod_limits(self.scenario)
        text = f"What sets the bandwidth: {'; '.join(parts)}."
        if math.isfinite(acceleration):
            text += (
                f" The motor gives the rod at most {1e3 * speed:.3g} mm/s and "
                f"{acceleration:.3g} m/s²: below {1e3 * speed**2 / acceleration:.2g} mm of rod "
                f"amplitude a sine meets the acceleration limit first, above it the speed limit."
            )
        return text

    def _linear_in_words(self) -> str:
        if self.linear_failure:
            return f"There is no linear loop to compare with: {self.linear_failure}."
        free, counted = (self.linear_deviation(quantized=quantized) for quantized in (False, True))
        if math.isnan(free):
            return (
                f"At {self.amplitudes_deg[0]:g}° the motor reaches its limits, or the run fails, "
                f"at every frequency: there is nothing to compare with the linear loop."
            )
        text = (
            f"Where the motor stays off its limits, the response at {self.amplitudes_deg[0]:g}° "
            f"differs from that of the linear loop by at most {100 * free:.2g} % without the "
            f"encoder's counts"
        )
        if self.scenario.encoder.quantized and not math.isnan(counted):
            text += f", {100 * counted:.2g} % with them"
        return text + "."

    def _wandering_in_words(self) -> str:
        away = np.abs(self.cells["mean_deg"] - require_sine(self.scenario).mean_deg)
        count = int(np.sum(away > _WANDERING_DEG))
        if not count:
            return ""
        i, j = np.unravel_index(np.nanargmax(away), away.shape)
        return (
            f"At {count} sines the mean of the knee leaves the reference's by more than "
            f"{_WANDERING_DEG:g}°, most ({away[i, j]:.3g}°) at {self.amplitudes_deg[i]:g}° and "
            f"{self.frequencies_hz[j]:g} Hz: a motor that a fast sine keeps at its limits has "
            f"little authority left to hold the mean."
        )

    # ----------------------------------------------------------------------------- figures

    def figures(self) -> dict[str, Figure]:
        """The map, the Bode plots over each other, and the closed form of the rate-limited sine."""
        return {
            "amplitude_map": self.plot_map(),
            "bode_by_amplitude": self.plot_bode(),
            "rate_limited_sine": self.plot_rate_limit(),
        }

    def plot_map(self) -> Figure:
        """Gain, phase and the motor's limits over frequency and amplitude."""
        import matplotlib.pyplot as plt
        from matplotlib.colors import Normalize

        figure, axes = plt.subplots(
            2, 2, figsize=(11, 7.5), sharex=True, sharey=True, layout="constrained"
        )
        f, amplitudes = self.frequencies_hz, self.amplitudes_deg
        share, phase = Normalize(0.0, 1.0), self.phase_deg
        low, high = np.nanmin(phase, initial=0.0), np.nanmax(phase, initial=0.0)
        for axis, values, norm, label in zip(
            axes.flat,
            (
                self.gain_db,
                phase,
                self.cells["speed_limited_share"],
                self.cells["acceleration_limited_share"],
            ),
            (Normalize(-20.0, 3.0), Normalize(low, high), share, share),
            (
                "gain (dB)",
                "phase (deg)",
                "share of time at the speed limit",
                "share of time at the acceleration limit",
            ),
            strict=True,
        ):
            heat_map(axis, f, amplitudes, values.T, norm=norm, label=label)
        for axis in axes[1]:
            measured = self.bandwidths["measured_hz"]
            axis.plot(measured, amplitudes, "wo", mec="k", ms=5, label="−3 dB, measured")
            axis.legend(loc="lower left", fontsize=8, facecolor="0.75")
            axis.set_xlabel("frequency (Hz)")
        for axis in axes[:, 0]:
            axis.set_ylabel("amplitude (deg)")
        self._plot_bandwidths(axes[0, 0])
        reached = self.bandwidths["speed_limit_reached_hz"]
        axes[1, 0].plot(reached, amplitudes, "C3.-", label="the reference asks for more speed")
        axes[1, 0].legend(loc="lower left", fontsize=8, facecolor="0.75")
        axes[0, 0].set(xlim=cell_borders(f)[[0, -1]], ylim=cell_borders(amplitudes)[[0, -1]])
        plain_ticks(axes[0, 0].xaxis, _TICKS_HZ)
        plain_ticks(axes[0, 0].yaxis, amplitudes)
        return figure

    def _plot_bandwidths(self, axis: Axes) -> None:
        """The −3 dB frequencies, measured and predicted, over amplitude."""
        if self.amplitudes_deg.size > 1:
            axis.contour(
                self.frequencies_hz,
                self.amplitudes_deg,
                self.gain_db,
                levels=[_MINUS_3_DB],
                colors="w",
                linestyles="-",
            )
        axis.plot([], [], "w-", label="−3 dB, interpolated in the map")
        for name, style, label in (
            ("measured_hz", "wo", "−3 dB, measured"),
            ("rate_limit_hz", "C3.-", "speed limit, closed form"),
            ("follower_hz", "C1x", "speed limit, follower through x(θ)"),
            ("acceleration_bound_hz", "C6.--", "acceleration bound"),
            ("linear_loop_hz", "C9.:", "linear loop"),
        ):
            edge = "k" if name == "measured_hz" else None
            axis.plot(self.bandwidths[name], self.amplitudes_deg, style, label=label, mec=edge)
        axis.legend(loc="lower left", fontsize=8, facecolor="0.75")

    def plot_bode(self) -> Figure:
        """Bode plots by amplitude, over the linear loop and the rate-limited follower."""
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(2, 1, sharex=True, figsize=(7.5, 7.5), layout="constrained")
        colours = plt.get_cmap("viridis_r")(np.linspace(0.15, 1.0, self.amplitudes_deg.size))
        relative = self.relative_uncertainty
        panels = (
            (self.gain_db, 20.0 * np.log10(1.0 + relative), _decibel),
            (self.phase_deg, np.degrees(np.arcsin(np.minimum(relative, 1.0))), _unwrapped_deg),
        )
        for axis, (measured, errors, shown) in zip(axes, panels, strict=True):
            for i, amplitude in enumerate(self.amplitudes_deg):
                axis.errorbar(
                    self.frequencies_hz,
                    measured[i],
                    errors[i],
                    fmt="o-",
                    ms=3,
                    lw=1.2,
                    color=colours[i],
                    label=f"{amplitude:g}°",
                )
                axis.plot(
                    self.frequencies_hz, shown(self.follower[i]), ":", lw=1.2, color=colours[i]
                )
            axis.plot(self.frequencies_hz, shown(self.linear), "k--", lw=1.2, label="linear loop")
            axis.plot([], [], ":", color="0.4", label="rate-limited follower")
            axis.grid(alpha=0.3)
        axes[0].axhline(_MINUS_3_DB, color="0.5", lw=0.8, label="−3 dB")
        axes[0].set(ylabel="gain (dB)", ylim=(-45.0, 5.0), xscale="log")
        axes[1].set(xlabel="frequency (Hz)", ylabel="phase (deg)")
        plain_ticks(axes[0].xaxis, _TICKS_HZ)
        axes[0].legend(loc="lower left", fontsize=8, ncols=2)
        return figure

    def plot_rate_limit(self) -> Figure:
        """Rate-limited sines in time; gains of all amplitudes over aω/R, with the closed form."""
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
        time = np.linspace(0.0, 4.0, 4001)
        target, shown = np.sin(math.tau * time), slice(2500, None)
        axes[0].plot(time[shown] - 2.5, target[shown], "k", lw=1, label="sine")
        for ratio in (0.8, _RATIO_AT_MINUS_3_DB, 0.3):
            follower = rate_limited_follower(time, target, math.tau * ratio)
            axes[0].plot(time[shown] - 2.5, follower[shown], label=f"ρ = {ratio:.3g}")
        axes[0].set(xlabel="time (periods)", ylabel="position (amplitudes)", ylim=(-1.1, 1.6))
        axes[0].legend(loc="upper center", fontsize=8, ncols=4)
        reached = self.frequencies_hz / self.bandwidths["rate_limit_hz"][:, None]
        demand = reached / _RATIO_AT_MINUS_3_DB
        colours = plt.get_cmap("viridis_r")(np.linspace(0.15, 1.0, self.amplitudes_deg.size))
        for i, amplitude in enumerate(self.amplitudes_deg):
            axes[1].plot(
                demand[i], self.gain_db[i], "o", ms=3, color=colours[i], label=f"{amplitude:g}°"
            )
        grid = np.geomspace(demand.min(), demand.max(), 400)
        closed = _decibel(rate_limited_gain(1.0 / grid))
        axes[1].plot(grid, closed, "C3", lw=1.2, label="closed form")
        axes[1].axhline(_MINUS_3_DB, color="0.5", lw=0.8, label="−3 dB")
        axes[1].set(
            xlabel="speed demand aω/R = 1/ρ (1)",
            ylabel="gain (dB)",
            xscale="log",
            ylim=(-45.0, 5.0),
        )
        axes[1].grid(alpha=0.3)
        axes[1].legend(loc="lower left", fontsize=8)
        return figure


def _decibel(response: Any) -> Any:
    return 20.0 * np.log10(np.abs(response))


def _unwrapped_deg(response: Any) -> Array:
    """Phase in deg of ``response`` (n,), unwrapped over its finite values."""
    phase = np.angle(response)
    finite = np.isfinite(phase)
    phase[finite] = np.unwrap(phase[finite])
    return np.degrees(phase)


# ---------------------------------------------------------------------------------- measurement

_Item = tuple[float, float | None, bool]
"""Amplitude (deg), frequency (Hz; None: where is −3 dB?), with the encoder's counts."""


@needs_runs
def _measure(
    scenario: Scenario, settings: SineEstimateParameters, item: _Item
) -> Steps[dict[str, Any]]:
    """One piece of the map as plain data."""
    amplitude, frequency, quantized = item
    values = {"reference.amplitude_deg": amplitude, "encoder.quantized": quantized}
    if frequency is not None:
        values["reference.frequency_hz"] = frequency
    at = changed(scenario, values)
    try:
        if frequency is None:
            bandwidth = yield from steps(large_signal_bandwidth_hz, at)
            return {"measured_hz": bandwidth, "failure": ""}
        found = yield from steps(estimate_sine, at, settings)
    except SimulationError as error:
        failed = {"measured_hz": math.nan, "response": [math.nan, math.nan]}
        return CELL | failed | {"failure": str(error)}
    response = [found.response.real, found.response.imag]
    return {name: getattr(found, name) for name in CELL} | {"response": response, "failure": ""}


def _column(found: list[dict[str, Any]], name: str) -> Any:
    return np.array([row[name] for row in found])


def _response(found: list[dict[str, Any]]) -> Complex:
    return np.asarray(_column(found, "response") @ [1.0, 1.0j], dtype=complex)


def amplitude_map(
    scenario: Scenario = Scenario(),
    settings: AmplitudeMapParameters = AmplitudeMapParameters(),
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = False,
) -> AmplitudeMap:
    """Measure the closed loop's frequency response at several amplitudes of the knee's sine.

    ``scenario`` needs a sinusoidal reference; its amplitude and frequency are replaced. A run that
    fails leaves its cell nan and goes into ``failures``. ``workers``, ``executor``,
    ``checkpoint``: see `parallel_map`.

    Raises `ParameterError` when the reference is no sine, leaves the range of motion, or has fewer
    than ten samples a period.
    """
    amplitudes, frequencies = settings.amplitudes_deg, np.array(settings.frequencies_hz)
    mean_deg = require_sine(scenario).mean_deg
    require_sampled(frequencies[-1], scenario)
    at = [changed(scenario, {"reference.amplitude_deg": a}) for a in amplitudes]  # checks them
    quantized = scenario.encoder.quantized
    cells: list[_Item] = [(a, f, quantized) for a in amplitudes for f in settings.frequencies_hz]
    small: list[_Item] = [(amplitudes[0], f, False) for f in settings.frequencies_hz if quantized]
    searches: list[_Item] = [(a, None, quantized) for a in amplitudes]
    items = [*cells, *small, *searches]
    found = parallel_map(
        partial(_measure, scenario, settings.estimate),
        items,
        workers=workers,
        executor=executor,
        checkpoint=checkpoint,
        description="amplitude map" if progress else None,
        weight=lambda item: 1.0 / (item[1] or 1.0),
    )
    grid, searched = found[: len(cells)], found[len(cells) + len(small) :]
    unquantized = found[len(cells) : len(cells) + len(small)] or grid[: frequencies.size]
    limited = _column(unquantized, "speed_limited_share")
    limited = limited + _column(unquantized, "acceleration_limited_share")

    linear, linear_hz, failure = (
        np.full(frequencies.size, complex(math.nan, math.nan)),
        math.nan,
        "",
    )
    try:
        loop = linearize_loop(scenario, mean_deg)
        linear_hz, linear = loop.bandwidth_hz(), loop.output_response(frequencies)
    except LinearizationError as error:
        failure = str(error)
    speed, acceleration = rod_limits(scenario)
    rod = [rod_amplitude_m(s) for s in at]
    shape = (len(amplitudes), frequencies.size)
    return AmplitudeMap(
        amplitudes_deg=np.array(amplitudes),
        frequencies_hz=frequencies,
        response=_response(grid).reshape(shape),
        cells={name: _column(grid, name).reshape(shape) for name in CELL},
        bandwidths={
            "measured_hz": _column(searched, "measured_hz"),
            "linear_loop_hz": np.full(len(amplitudes), linear_hz),
            "acceleration_bound_hz": np.array(
                [acceleration_bound_hz(acceleration, a) for a in rod]
            ),
            "follower_hz": np.array([follower_bandwidth_hz(s) for s in at]),
            "rate_limit_hz": np.array([rate_limit_bandwidth_hz(speed, a) for a in rod]),
            "speed_limit_reached_hz": np.array([speed_limit_reached_hz(s) for s in at]),
        },
        linear=linear,
        linear_failure=failure,
        follower=np.array([[follower_response(s, f) for f in frequencies] for s in at]),
        unquantized=_response(unquantized),
        unlimited=limited == 0.0,
        failures=tuple(
            f"{a:g} deg, {'−3 dB' if f is None else f'{f:g} Hz'}: {row['failure']}"
            for (a, f, _), row in zip(items, found, strict=True)
            if row["failure"]
        ),
        scenario=scenario,
        settings=settings,
    )
