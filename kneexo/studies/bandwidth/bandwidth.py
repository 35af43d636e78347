"""Frequency response of the knee over amplitude and frequency, and the limits that explain it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, Unpack

import numpy as np
from pydantic import field_validator

from kneexo.analysis.frequency.bandwidth import (
    acceleration_bound_hz,
    follower_bandwidth_hz,
    follower_response,
    large_signal_bandwidth_hz,
    rod_amplitude_m,
    rod_limits,
    speed_limit_reached_hz,
)
from kneexo.analysis.frequency.frequency_response import (
    require_sampled,
    require_sine,
)
from kneexo.analysis.frequency.rate_limit import rate_limit_bandwidth_hz
from kneexo.analysis.frequency.sine_estimate import SineEstimateSettings, estimate_sine
from kneexo.analysis.linear.plant_linearization import Complex
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.signals import unwrapped_deg
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import LinearizationError, SimulationError, failure_noted
from kneexo.parameters import Scenario
from kneexo.parameters.fields.quantity import Parameters, quantities, require_increasing
from kneexo.parameters.paths import changed
from kneexo.simulation import needs_runs
from kneexo.sweeps import SweepOptions, open_sweep


class BandwidthSettings(Parameters):
    """Settings of ``kneexo study bandwidth``: sines of the reference, and their measurement."""

    amplitudes_deg: tuple[float, ...] = quantities(
        (0.1, 0.3, 1.0, 3.0, 10.0, 30.0),
        "deg",
        "assumption: from about one count of the encoder to Section 5's 10…70°",
        ge=1e-6,
        le=46,
    )
    frequencies_hz: tuple[float, ...] = quantities(
        (
            *(0.05, 0.063, 0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.315, 0.4, 0.5, 0.63, 0.8),
            *(1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0, 10.0, 12.5, 16.0, 20.0),
        ),
        "Hz",
        "assumption: preferred numbers (R 10) about the bandwidths of all amplitudes",
        ge=1e-5,
        le=250,
        min_length=3,
    )
    estimate: SineEstimateSettings = SineEstimateSettings()

    _increasing = field_validator("amplitudes_deg", "frequencies_hz")(require_increasing)


_LEAST_GAIN = 1e-12  # lower limit for decibels; the knee may not move within a count of the encoder
# Curves of the Bode plot that a limit of the hardware or of linear theory gives, with their words.
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
"""Values that a map cell gets if its run fails. Each name is an attribute of `SineEstimate`."""


@dataclass(frozen=True, repr=False)
class BandwidthResult(Result):
    """Frequency response θ_p/θ_d over m amplitudes and n frequencies of a sine reference.

    θ_p is the fundamental of the knee angle and θ_d the reference. ``response`` is complex (m, n).
    ``cells`` has an array (m, n) for each name of `CELL`. If a run fails, its numbers are nan, and
    ``failures`` has a line with the reason.

    ``bandwidths`` maps a name to frequencies (m,) in Hz. ``measured_hz`` is the measured −3 dB
    frequency (`large_signal_bandwidth_hz`). Four −3 dB frequencies are predicted from one limit
    each: ``linear_loop_hz``, ``acceleration_bound_hz``, ``follower_hz`` (speed limit, through x(θ))
    and ``rate_limit_hz`` (speed limit, closed form for a sine of the rod). Above
    ``speed_limit_reached_hz`` the reference requires more than the speed limit.

    ``linear`` (n,) is the response of the linear loop. ``follower`` (m, n) is the response of a rod
    that is limited only in speed. ``unquantized`` (n,) is the response without quantizers at the
    smallest amplitude. ``unlimited`` (n,) is True for the frequencies at which the motor stays off
    its limits in this measurement without quantizers.
    """

    amplitudes_deg: Array
    frequencies_hz: Array
    response: Complex
    cells: dict[str, Any]
    bandwidths: dict[str, Array]
    linear: Complex
    linear_failure: str
    """Empty, or the reason why the loop could not be linearized, so that ``linear`` is nan."""
    follower: Complex
    unquantized: Complex
    unlimited: Any
    failures: tuple[str, ...]
    scenario: Scenario
    settings: BandwidthSettings

    @property
    def gain_db(self) -> Array:
        """Gain |θ_p/θ_d| in dB, an array (m, n) over amplitude and frequency."""
        return np.asarray(20.0 * np.log10(np.maximum(np.abs(self.response), _LEAST_GAIN)))

    @property
    def phase_deg(self) -> Array:
        """Phase of θ_p/θ_d in deg, an array (m, n), unwrapped along the frequency."""
        return unwrapped_deg(self.response)

    @property
    def relative_uncertainty(self) -> Array:
        """Uncertainty of the response divided by the gain, an array (m, n)."""
        return self.cells["uncertainty"] / np.maximum(np.abs(self.response), _LEAST_GAIN)

    def linear_deviation(self, *, quantized: bool) -> float:
        """Return the largest |G − G_linear|/|G_linear| at the smallest amplitude.

        G is the response measured with quantizers (``quantized=True``) or without. G_linear is the
        response of the linear loop. Only frequencies at which the motor stays off its limits count.
        The result is nan if there is no such frequency or no linear loop.
        """
        measured = self.response[0] if quantized else self.unquantized
        deviation = np.abs(measured / self.linear - 1.0)[self.unlimited]
        return float(np.max(deviation)) if deviation.size else math.nan

    def decided_by(self, index: int) -> tuple[str, float]:
        """Return the name of the limit that predicts the lowest bandwidth, and the bandwidth in Hz.

        ``index`` selects the amplitude.
        """
        predicted = {_LIMITS[name]: float(self.bandwidths[name][index]) for name in _LIMITS}
        name = min(predicted, key=lambda n: np.nan_to_num(predicted[n], nan=math.inf))
        return name, predicted[name]

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` with a row for each cell of the map.

        The columns are ``amplitude_deg``, ``frequency_hz``, ``gain``, ``phase_deg`` and the names
        in `CELL`. Raises `PackageError` without pandas.
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
        """Return plain data: the linear loop, the map by amplitude, and the reasons of failures."""
        gain, phase = np.abs(self.response), self.phase_deg
        return {
            "frequencies_hz": self.frequencies_hz.tolist(),
            "linear_loop": {
                "gain": np.abs(self.linear).tolist(),
                "phase_deg": unwrapped_deg(self.linear).tolist(),
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


def decibel(response: Any) -> Any:
    """Return the gain in dB of a complex response of any shape."""
    return 20.0 * np.log10(np.abs(response))


# ---------------------------------------------------------------------------------- measurement

_Item = tuple[float, float | None, bool]
"""A measurement: amplitude in deg, frequency in Hz, and whether encoder and bus round.

Frequency None asks for the −3 dB frequency instead of the response at one frequency.
"""


@needs_runs
def _measure(scenario: Scenario, settings: SineEstimateSettings, item: _Item) -> dict[str, Any]:
    """Measure the response to one sine, or search for the −3 dB frequency. Return plain data.

    If a run fails, the numbers are nan and ``failure`` has the reason. Otherwise ``failure`` is
    empty.
    """
    amplitude, frequency, quantized = item
    values = {"reference.amplitude_deg": amplitude}
    if frequency is not None:
        values["reference.frequency_hz"] = frequency
    driven = changed(scenario if quantized else scenario.without_quantizers(), values)
    row = CELL | {"measured_hz": math.nan, "response": [math.nan, math.nan]}
    with failure_noted(row, kind=SimulationError):
        if frequency is None:
            row["measured_hz"] = large_signal_bandwidth_hz(driven)
        else:
            estimate = estimate_sine(driven, settings)
            row |= {name: getattr(estimate, name) for name in CELL}
            row["response"] = [estimate.response.real, estimate.response.imag]
    return row


def _column(rows: list[dict[str, Any]], name: str) -> Any:
    return np.array([row[name] for row in rows])


def _response(rows: list[dict[str, Any]]) -> Complex:
    return np.asarray(_column(rows, "response") @ [1.0, 1.0j], dtype=complex)


def bandwidth_study(
    scenario: Scenario = Scenario(),
    settings: BandwidthSettings = BandwidthSettings(),
    **options: Unpack[SweepOptions],
) -> BandwidthResult:
    """Measure the closed loop's frequency response at several amplitudes of the knee's sine.

    If a run fails, its cell of the result is nan, and ``failures`` has the reason.

    Parameters
    ----------
    scenario
        A scenario whose reference is a sine. The study replaces amplitude and frequency of the
        sine.
    settings
        Amplitudes and frequencies, and when a response counts as settled.
    options
        Workers, checkpoint and progress: see `kneexo.sweeps.SweepOptions`.

    Raises
    ------
    ParameterError
        The reference is not a sine, leaves the range of motion, or has fewer than ten samples a
        period.
    """
    amplitudes, frequencies = settings.amplitudes_deg, np.array(settings.frequencies_hz)
    mean_deg = require_sine(scenario).mean_deg
    require_sampled(frequencies[-1], scenario)
    scenarios = [changed(scenario, {"reference.amplitude_deg": a}) for a in amplitudes]  # may raise
    quantized = scenario.quantized
    cells: list[_Item] = [(a, f, quantized) for a in amplitudes for f in settings.frequencies_hz]
    small: list[_Item] = []  # without quantizers the first row of the map has these measurements
    if quantized:
        small = [(amplitudes[0], f, False) for f in settings.frequencies_hz]
    searches: list[_Item] = [(a, None, quantized) for a in amplitudes]
    items = [*cells, *small, *searches]
    with open_sweep(**options) as sweep:
        measured = sweep.map(
            partial(_measure, scenario, settings.estimate),
            items,
            "amplitude map",
            # A run lasts some periods. A search counts as a run at 1 Hz.
            weight=lambda item: 1.0 / (item[1] or 1.0),
        )
    grid, searched = measured[: len(cells)], measured[len(cells) + len(small) :]
    unquantized = measured[len(cells) : len(cells) + len(small)] or grid[: frequencies.size]
    limits = ("speed_limited_share", "acceleration_limited_share")
    limited_share = np.sum([_column(unquantized, name) for name in limits], axis=0)

    linear: dict[str, Any] = {
        "hz": math.nan,
        "response": np.full(frequencies.size, complex(math.nan, math.nan)),
    }
    with failure_noted(linear, kind=LinearizationError):  # sets linear["failure"]
        loop = linearize_loop(scenario, knee_angle_deg=mean_deg)
        linear |= {"hz": loop.bandwidth_hz(), "response": loop.output_response(frequencies)}
    speed, acceleration = rod_limits(scenario)
    rod = [rod_amplitude_m(s) for s in scenarios]
    shape = (len(amplitudes), frequencies.size)
    return BandwidthResult(
        amplitudes_deg=np.array(amplitudes),
        frequencies_hz=frequencies,
        response=_response(grid).reshape(shape),
        cells={name: _column(grid, name).reshape(shape) for name in CELL},
        bandwidths={
            "measured_hz": _column(searched, "measured_hz"),
            "linear_loop_hz": np.full(len(amplitudes), linear["hz"]),
            "acceleration_bound_hz": np.array(
                [acceleration_bound_hz(acceleration, a) for a in rod]
            ),
            "follower_hz": np.array([follower_bandwidth_hz(s) for s in scenarios]),
            "rate_limit_hz": np.array([rate_limit_bandwidth_hz(speed, a) for a in rod]),
            "speed_limit_reached_hz": np.array([speed_limit_reached_hz(s) for s in scenarios]),
        },
        linear=linear["response"],
        linear_failure=linear["failure"],
        follower=np.array([[follower_response(s, f) for f in frequencies] for s in scenarios]),
        unquantized=_response(unquantized),
        unlimited=limited_share == 0.0,
        failures=tuple(
            f"{a:g} deg, {'−3 dB' if f is None else f'{f:g} Hz'}: {row['failure']}"
            for (a, f, _), row in zip(items, measured, strict=True)
            if row["failure"]
        ),
        scenario=scenario,
        settings=settings,
    )
