"""Frequency response of the closed loop by a sinestream, a test with one sine after another.

`sinestream` repeats the experiment of Lee et al. 2020, Fig. 13. Each trial has a fixed number of
cycles. `kneexo.analysis.frequency.sine_estimate` measures the response to one sine more accurately.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy
from pydantic import model_validator
from pydrake.trajectories import PiecewisePolynomial

from kneexo.analysis.signals import unwrapped_deg
from kneexo.common.plotting import BLUE, TEAL, axes_or_new
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError
from kneexo.parameters import UNCERTAINTY, Scenario, SineReference, Uncertainty, UncertaintySet
from kneexo.parameters.criteria import MINUS_3_DB
from kneexo.parameters.fields.quantity import Parameters, ordered_limits, quantities, quantity
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import draw
from kneexo.simulation import needs_runs, simulate
from kneexo.sweeps.parallel import parallel_map

_LEAKAGE = "plant.pump.internal_leakage_m3_per_s_pa"
_ACCELERATION = "plant.pump.acceleration_limit_rad_s2"
_BULK_MODULUS = "plant.cylinder.bulk_modulus_pa"
_MASS = "plant.cylinder.mass_kg"
_TRIALS = "assumption: spread of the five repetitions of Fig. 13, which the paper does not describe"


def _end(path: str, end: int, unit: str, ge: float, le: float, source: str = _TRIALS) -> Any:
    """Return a field of `SinestreamSettings`: an end of the range of a value that trials vary."""
    return quantity(UNCERTAINTY.values[path].levels[end], unit, source, ge=ge, le=le)


class SinestreamSettings(Parameters):
    """Frequencies and cycles of a sinestream, and the ranges of the values that vary by trial."""

    frequencies_hz: tuple[float, ...] = quantities(
        (
            *(0.05, 0.07, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2),
            *(0.21, 0.22, 0.23, 0.24, 0.27, 0.31, 0.38, 0.5),
        ),
        "Hz",
        "assumption: Fig. 13 spans the neighbourhood of its 0.21 Hz",
        ge=1e-5,
        le=250,
        min_length=3,
    )
    transient_cycles: int = quantity(
        1, "cycles", "assumption: discarded before measuring", ge=0, le=1000
    )
    measured_cycles: int = quantity(3, "cycles", "Section 5: more than three cycles", ge=1, le=1000)
    trials: int = quantity(5, "1", "Section 5: five times for each frequency", ge=1, le=10_000)
    seed: int = quantity(2020, "1", "assumption: any number", ge=0)
    internal_leakage_min_m3_per_s_pa: float = _end(_LEAKAGE, 0, "m³/(s·Pa)", 1e-18, 1e-9)
    internal_leakage_max_m3_per_s_pa: float = _end(_LEAKAGE, 1, "m³/(s·Pa)", 1e-18, 1e-9)
    acceleration_limit_min_rad_s2: float = _end(_ACCELERATION, 0, "rad/s²", 1, 1e7)
    acceleration_limit_max_rad_s2: float = _end(_ACCELERATION, 1, "rad/s²", 1, 1e7)
    bulk_modulus_min_pa: float = _end(
        _BULK_MODULUS, 0, "Pa", 1e6, 1e11, source=_TRIALS + "; entrained air"
    )
    bulk_modulus_max_pa: float = _end(_BULK_MODULUS, 1, "Pa", 1e6, 1e11)
    mass_min_kg: float = _end(_MASS, 0, "kg", 0.01, 1000, source="Table 2")
    mass_max_kg: float = _end(_MASS, 1, "kg", 0.01, 1000, source="Table 2")

    _ordered = ordered_limits()

    @model_validator(mode="after")
    def _different(self) -> SinestreamSettings:
        if len(set(self.frequencies_hz)) < len(self.frequencies_hz):
            raise ValueError("frequencies_hz must not repeat a value")
        return self


_TICKS_HZ = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def trial_uncertainty(scenario: Scenario, settings: SinestreamSettings) -> UncertaintySet:
    """Return the values that differ between trials, with the ranges of ``settings``.

    Mass and encoder phase have uniform distributions. Leakage, acceleration limit and bulk modulus
    have log-uniform distributions, because only their orders of magnitude are known. The range of
    the encoder phase is one count of the encoder.
    """
    ranges: dict[str, tuple[float, float]] = {
        _LEAKAGE: (
            settings.internal_leakage_min_m3_per_s_pa,
            settings.internal_leakage_max_m3_per_s_pa,
        ),
        _ACCELERATION: (
            settings.acceleration_limit_min_rad_s2,
            settings.acceleration_limit_max_rad_s2,
        ),
        _BULK_MODULUS: (settings.bulk_modulus_min_pa, settings.bulk_modulus_max_pa),
        _MASS: (settings.mass_min_kg, settings.mass_max_kg),
    }
    values = {
        path: Uncertainty(low=low, high=high, scale=UNCERTAINTY.values[path].scale)
        if low < high
        else Uncertainty(options=(low,))
        for path, (low, high) in ranges.items()
    }
    phase = Uncertainty(low=0.0, high=scenario.encoder.resolution_rad)
    return UncertaintySet(values=values | {"encoder.phase_rad": phase})


def draw_trials(scenario: Scenario, settings: SinestreamSettings) -> list[dict[str, Any]]:
    """Sample the trials at random from `trial_uncertainty`, with the seed of ``settings``.

    Returns one dictionary for each trial, from the path of a value in the scenario to the value.
    """
    return draw(trial_uncertainty(scenario, settings), settings.trials, settings.seed)


@dataclass(frozen=True, repr=False)
class FrequencyResponse(Result):
    """Complex response θ_p/θ_d of the knee angle to its reference, measured sine by sine.

    ``response`` is complex with the shape (trials, n) at the n ``frequencies_hz``. At
    ``bandwidth_hz`` the mean gain over the trials falls to 1/√2. A shape-preserving cubic (PCHIP)
    interpolates the gain between the frequencies. ``phase_at_bandwidth_deg`` is the mean phase at
    the bandwidth. Bandwidth and its phase are nan if the gain does not fall to 1/√2.
    """

    frequencies_hz: Array
    response: Any
    bandwidth_hz: float
    phase_at_bandwidth_deg: float
    trials: tuple[Mapping[str, Any], ...]
    scenario: Scenario
    settings: SinestreamSettings

    @property
    def gain(self) -> Array:
        """Mean gain over the trials, (n,)."""
        return np.asarray(np.mean(np.abs(self.response), axis=0))

    @property
    def phase_deg(self) -> Array:
        """Mean phase over the trials in deg, unwrapped over frequency, (n,)."""
        return np.asarray(np.mean(unwrapped_deg(self.response), axis=0))

    def to_dataframe(self) -> Any:
        """Return means and trials as a `pandas.DataFrame` with the index ``frequency_hz``.

        The columns ``gain`` and ``phase_deg`` are means over the trials. The columns ``gain_1`` and
        ``phase_1_deg`` belong to the first trial, and so on. Raises `PackageError` without pandas.
        """
        trials = enumerate(zip(self.response, unwrapped_deg(self.response), strict=True), 1)
        columns = {"frequency_hz": self.frequencies_hz, "gain": self.gain}
        columns["phase_deg"] = self.phase_deg
        for number, (response, phase) in trials:
            columns[f"gain_{number}"] = np.abs(response)
            columns[f"phase_{number}_deg"] = phase
        return data_frame(columns, "frequency_hz")

    def plot(self, ax: Any = None) -> Any:
        """Plot trials, means and PCHIP of magnitude and phase; return two Matplotlib axes."""
        count = len(self.response)
        trials = f"{count} trial{'s' if count > 1 else ''}"
        caption = (
            "Gain and phase of the knee angle relative to its reference, measured with sines. "
            f"The curve interpolates the mean of {trials} monotonically (PCHIP)."
        )
        ax = axes_or_new(ax, 1, 2, caption=caption, figsize=(8.6, 3.9))
        f = self.frequencies_hz
        fine = np.linspace(f[0], f[-1], 400)
        gains, phases = np.abs(self.response), unwrapped_deg(self.response)
        decibel = 20.0 * np.log10(_pchip(f, self.gain).vector_values(fine)[0])
        phase = _pchip(f, self.phase_deg).vector_values(fine)[0]
        for index, (values, curve, mean, label) in enumerate(
            (
                (20.0 * np.log10(gains), decibel, 20.0 * np.log10(self.gain), "magnitude (dB)"),
                (phases, phase, self.phase_deg, "phase (deg)"),
            )
        ):
            axis = ax[index]
            for trial in values:
                axis.plot(f, trial, ".", color="0.6", ms=5)
            axis.plot([], [], ".", color="0.6", label=trials)
            axis.plot(f, mean, "o", color=BLUE, ms=4, label="mean")
            axis.plot(fine, curve, BLUE, lw=1.2, label="interpolation")
            axis.set(xlabel="frequency (Hz)", ylabel=label, xscale="log")
            ticks = [t for t in _TICKS_HZ if f[0] <= t <= f[-1]]
            axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
            axis.minorticks_off()
            axis.grid(alpha=0.3)
        if math.isfinite(self.bandwidth_hz):
            ax[0].axhline(20.0 * math.log10(MINUS_3_DB), color="0.5", ls="--", lw=1)
            for axis in ax:
                axis.axvline(
                    self.bandwidth_hz,
                    color=TEAL,
                    ls="--",
                    lw=1,
                    label=f"−3 dB at {self.bandwidth_hz:.3g} Hz",
                )
        ax[0].set_title("(a) magnitude")
        ax[1].set_title("(b) phase")
        ax[0].legend(loc="lower left")
        return ax


def fundamental(time_s: Array, signal: Array, frequency_hz: float) -> complex:
    """Return the complex amplitude A of a signal at a frequency.

    The sum c + Re(A e^{jωt}), with a constant c, fits the signal best by least squares.

    Parameters
    ----------
    time_s, signal
        Times in s and the values of the signal, (n,) each. The samples should cover whole
        periods, so that harmonics have no effect.
    frequency_hz
        The frequency ω/2π in Hz.
    """
    phase = 2.0 * np.pi * frequency_hz * time_s
    basis = np.column_stack([np.ones_like(phase), np.cos(phase), -np.sin(phase)])
    _, real, imaginary = np.linalg.lstsq(basis, signal, rcond=None)[0]
    return complex(real, imaginary)


def _pchip(x: Array, y: Array) -> PiecewisePolynomial:
    # A shape-preserving cubic does not overshoot between measured gains, so it has no crossing of
    # its own.
    return PiecewisePolynomial.CubicShapePreserving(x, y[None, :])


def crossing(frequencies_hz: Array, gain: Array) -> float:
    """Return the first frequency in Hz at which a curve through ``gain`` (n,) falls to 1/√2.

    The curve through ``gain`` is a shape-preserving cubic (PCHIP). The result is nan when the curve
    does not fall to 1/√2 within ``frequencies_hz`` (n,), which must be increasing.
    """
    below = np.flatnonzero((gain[:-1] >= MINUS_3_DB) & (gain[1:] < MINUS_3_DB))
    if below.size == 0:
        return math.nan
    curve = _pchip(frequencies_hz, gain)
    return float(
        scipy.optimize.brentq(
            lambda f: curve.value(f)[0, 0] - MINUS_3_DB,
            frequencies_hz[below[0]],
            frequencies_hz[below[0] + 1],
            xtol=1e-14,
        )
    )


@needs_runs
def _measure(settings: SinestreamSettings, work: tuple[float, Scenario]) -> complex:
    """Simulate one sine of the reference; return the complex response θ_p/θ_d at its frequency.

    ``work`` is the frequency in Hz and the scenario of the trial.
    """
    frequency, scenario = work
    cycles = settings.transient_cycles + settings.measured_cycles
    at = {"reference.frequency_hz": frequency, "simulation.duration_s": cycles / frequency}
    signals = ("knee_reference", "knee_angle")
    run = simulate(changed(scenario.undisturbed(), at), signals=signals)
    measured = run.time_s >= settings.transient_cycles / frequency
    measured[-1] = False  # the last sample repeats the phase of the first one
    time = run.time_s[measured]
    return fundamental(time, run["knee_angle_rad"][measured], frequency) / fundamental(
        time, run["knee_reference_rad"][measured], frequency
    )


def require_sine(scenario: Scenario) -> SineReference:
    """Return a scenario's reference, a sine that moves.

    Raises `ParameterError` for another reference, and for a torque controller, which does not
    follow the reference.
    """
    reference = scenario.reference
    if scenario.controller.kind == "torque":
        raise ParameterError(
            "controller.kind = torque: a sinestream needs a controller that follows the reference; "
            "kneexo study wearer measures torque"
        )
    if reference.kind != "sine" or reference.amplitude_deg == 0.0:
        shown = reference.kind if reference.kind != "sine" else "sine with amplitude_deg = 0 deg"
        raise ParameterError(f"reference = {shown}: a sinestream needs a sine that moves")
    return reference


def highest_frequency_hz(scenario: Scenario) -> float:
    """Return the highest frequency in Hz of a sine of which a period has ten control samples."""
    return 0.1 / scenario.controller.sample_time_s


def require_sampled(frequency_hz: float, scenario: Scenario) -> None:
    """Raise `ParameterError` if a period has fewer than ten samples of the controller."""
    highest = highest_frequency_hz(scenario)
    if frequency_hz > highest:
        nyquist = 5.0 * highest
        why = f" (and above the controller's Nyquist frequency of {nyquist:g} Hz)"
        raise ParameterError(
            f"frequencies_hz: {frequency_hz:g} Hz is too high: must be <= {highest:g} Hz, ten "
            f"samples a period{why if frequency_hz > nyquist else ''}"
        )


def sinestream(
    scenario: Scenario = Scenario(),
    settings: SinestreamSettings = SinestreamSettings(),
    *,
    trials: Sequence[Mapping[str, Any]] | None = None,
    workers: int | None = 1,
    executor: Executor | None = None,
    progress: bool = False,
) -> FrequencyResponse:
    """Measure the closed loop's frequency response with one sine after another.

    Each trial is simulated at each frequency. The transient cycles are discarded, and the
    fundamental is fitted to the other cycles.

    Parameters
    ----------
    scenario
        A scenario with a sinusoidal reference, whose frequency is replaced.
    settings
        Frequencies, numbers of cycles, and the ranges from which trials are drawn.
    trials
        For each trial a dictionary from path to value, which changes the scenario. The empty
        dictionary leaves the scenario unchanged. None: `draw_trials` makes the trials.
    workers, executor, progress
        Processes and progress bar, as in `parallel_map`.

    Raises
    ------
    ParameterError
        The reference is not a sine or does not move, there are no trials, or a frequency has fewer
        than ten samples a period.
    SimulationError
        A run fails.
    """
    require_sine(scenario)
    drawn = tuple(draw_trials(scenario, settings) if trials is None else trials)
    if not drawn:
        raise ParameterError("trials: there are none; a sinestream needs at least one")
    frequencies = sorted(settings.frequencies_hz)
    require_sampled(frequencies[-1], scenario)
    nominal = {"nominal": scenario.believed_plant}  # the controller does not know the trial
    cases = [changed(scenario, nominal | dict(values)) for values in drawn]
    values = parallel_map(
        partial(_measure, settings),
        [(frequency, case) for case in cases for frequency in frequencies],
        workers=workers,
        executor=executor,
        description="frequency response" if progress else None,
        # A run has a fixed number of cycles, so its duration falls with the frequency.
        weight=lambda item: 1.0 / item[0],
    )
    response = np.array(values).reshape(len(drawn), len(frequencies))
    f = np.array(frequencies)
    gain = np.mean(np.abs(response), axis=0)
    bandwidth = crossing(f, gain)
    phase = math.nan
    if math.isfinite(bandwidth):
        means = np.mean(unwrapped_deg(response), axis=0)
        phase = float(_pchip(f, means).value(bandwidth)[0, 0])
    return FrequencyResponse(f, response, bandwidth, phase, drawn, scenario, settings)
