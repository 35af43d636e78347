"""The closed loop of a scenario as control engineers ask for it: linear model, Bode plot, step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kneexo.analysis.linear.plant_linearization import Complex
from kneexo.analysis.linear.sampled_loop import SampledLoop, linearize_loop
from kneexo.analysis.signals import unwrapped_deg
from kneexo.analysis.tracking.tracking import TrackingResult, track
from kneexo.common.plotting import BLUE, GOLD, axes_or_new, label_bode
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario, StepReference
from kneexo.parameters.criteria import MINUS_3_DB
from kneexo.parameters.scenario_file import as_scenario
from kneexo.systems.knee_reference import run_middle_deg

STEP_TIME_S = 0.1
"""Time in s at which the reference of `step` jumps; until then the knee rests."""


def linearize(
    scenario: Scenario | str | PathLike[str] = Scenario(),
    *,
    knee_angle_deg: float | None = None,
    law: Any = None,
    initial_state: Sequence[float] = (),
) -> SampledLoop:
    """Linearize the sampled closed loop of a scenario at a constant knee angle.

    The result has poles, margins and bandwidths: ``print`` shows them, ``margins()`` returns them,
    and ``plot()`` draws the Bode plot of the loop transfer with its margins. `linearize_loop`
    describes the method and the errors.

    Parameters
    ----------
    scenario
        A scenario, or the path of a scenario file.
    knee_angle_deg
        The knee angle in deg. None: the middle of the reference within the run.
    law, initial_state
        A control law that replaces the law of the scenario: see `Scenario.with_law`.

    Examples
    --------
    >>> import kneexo as kx
    >>> margins = kx.linearize(knee_angle_deg=40.0).margins()
    >>> print(f"{margins.phase_margin_deg:.0f} deg, {1e3 * margins.delay_margin_s:.0f} ms")
    57 deg, 187 ms
    """
    scenario = as_scenario(scenario, law, initial_state)
    if knee_angle_deg is None:
        knee_angle_deg = run_middle_deg(scenario)
    return linearize_loop(scenario, knee_angle_deg=knee_angle_deg)


@dataclass(frozen=True, repr=False)
class BodeResponse(Result):
    """Frequency response of a linearized closed loop at ``frequencies_hz`` (n,).

    ``response`` (n,) is the complex gain from the reference θ_d to the knee angle θ_p, including
    the feedforward of the reference. ``complementary_sensitivity`` (n,) is L/(1 + L) of the loop
    transfer L, the feedback alone. Both responses are equal if the controller has no feedforward.
    """

    frequencies_hz: Array
    response: Complex
    complementary_sensitivity: Complex
    loop: SampledLoop

    @property
    def gain(self) -> Array:
        """Magnitude of ``response``, (n,)."""
        return np.abs(self.response)

    @property
    def phase_deg(self) -> Array:
        """Phase of ``response`` in deg, unwrapped over frequency, (n,)."""
        return unwrapped_deg(self.response)

    @property
    def bandwidth_hz(self) -> float:
        """The −3 dB bandwidth in Hz for small signals, or nan (`SampledLoop.bandwidth_hz`)."""
        return self.loop.bandwidth_hz()

    def __str__(self) -> str:
        """Return the lines of the `SampledLoop`, and the largest gain with its frequency."""
        peak = int(np.argmax(self.gain))
        return (
            f"{self.loop}\n"
            f"  largest gain {self.gain[peak]:.4g} at {self.frequencies_hz[peak]:.4g} Hz"
        )

    def to_dataframe(self) -> Any:
        """Return gain and phase as a `pandas.DataFrame` with the index ``frequency_hz``.

        Raises `PackageError` without pandas.
        """
        return data_frame(
            {
                "frequency_hz": self.frequencies_hz,
                "gain": self.gain,
                "phase_deg": self.phase_deg,
                "complementary_sensitivity_gain": np.abs(self.complementary_sensitivity),
                "complementary_sensitivity_phase_deg": unwrapped_deg(
                    self.complementary_sensitivity
                ),
            },
            "frequency_hz",
        )

    def plot(self, ax: Any = None) -> Any:
        """Plot magnitude and phase of both responses; return two Matplotlib axes."""
        caption = (
            "Bode plot of the linear closed loop, for sines inside the speed limit. "
            "The response to the reference includes the feedforward. "
            "The response of the feedback alone is L/(1 + L)."
        )
        ax = axes_or_new(ax, 2, 1, caption=caption, sharex=True, figsize=(7, 6))
        f = self.frequencies_hz
        for values, style, label in (
            (self.response, {"color": BLUE}, "knee angle / reference"),
            (
                self.complementary_sensitivity,
                {"color": GOLD, "ls": "--"},
                "L/(1 + L), feedback alone",
            ),
        ):
            ax[0].semilogx(f, 20.0 * np.log10(np.abs(values)), label=label, **style)
            ax[1].semilogx(f, unwrapped_deg(values), label=label, **style)
        ax[0].axhline(20.0 * math.log10(MINUS_3_DB), color="0.6", lw=0.8, label="−3 dB")
        if math.isfinite(bandwidth := self.bandwidth_hz):
            for axis in ax:
                label = f"bandwidth {bandwidth:.3g} Hz"
                axis.axvline(bandwidth, color="0.3", ls=":", lw=1, label=label)
        label_bode(ax, "magnitude (dB)")
        ax[0].legend(loc="lower left")
        return ax


def bode(
    scenario: Scenario | str | PathLike[str] = Scenario(),
    frequencies_hz: ArrayLike | None = None,
    *,
    knee_angle_deg: float | None = None,
    law: Any = None,
    initial_state: Sequence[float] = (),
) -> BodeResponse:
    """Return the frequency response of the closed loop from the knee's reference to its angle.

    The sampled loop is linearized, so the response is valid for small signals inside the speed
    limit. `large_signal_bandwidth_hz` measures the response to large sines. The Bode plot of the
    loop transfer, with its margins, is ``linearize(scenario).plot()``.

    Parameters
    ----------
    scenario
        A scenario, or the path of a scenario file.
    frequencies_hz
        Positive frequencies in Hz, (n,). None: from 0.02 Hz to the Nyquist frequency, dense around
        each resonance.
    knee_angle_deg
        The knee angle in deg. None: the middle of the reference within the run.
    law, initial_state
        A control law that replaces the law of the scenario: see `Scenario.with_law`.

    Raises
    ------
    LinearizationError
        The closed loop is unstable, a frequency is not positive and finite, or for the reasons of
        `linearize_loop`.

    Examples
    --------
    >>> import kneexo as kx
    >>> response = kx.bode(frequencies_hz=[0.1, 1.0, 10.0])
    >>> response.gain.round(2).tolist()
    [1.0, 1.06, 0.68]
    >>> print(f"bandwidth {response.bandwidth_hz:.1f} Hz")
    bandwidth 4.1 Hz
    """
    loop = linearize(scenario, knee_angle_deg=knee_angle_deg, law=law, initial_state=initial_state)
    loop.require_stable("frequency response")
    if frequencies_hz is None:
        frequencies_hz = loop.frequency_grid()
    f = np.atleast_1d(np.asarray(frequencies_hz, dtype=float))
    return BodeResponse(f, loop.output_response(f), loop.complementary_sensitivity(f), loop)


def step(
    scenario: Scenario | str | PathLike[str] = Scenario(),
    *,
    size_deg: float = 5.0,
    start_deg: float | None = None,
    duration_s: float = 2.0,
    law: Any = None,
    initial_state: Sequence[float] = (),
) -> TrackingResult:
    """Simulate the response of the knee to a step of its reference.

    `track` runs the whole model of the scenario, with its speed limit and quantizers. The step
    replaces the reference of the scenario, and the knee starts at rest on the reference. The
    attribute ``step`` of the result has rise time, overshoot and settling time (`StepMetrics`).

    Parameters
    ----------
    scenario
        A scenario, or the path of a scenario file.
    size_deg
        Height of the step in deg, negative for a step towards extension.
    start_deg
        Knee angle before the step in deg. None: the middle of the knee angles that the reference
        reaches within a run of the scenario.
    duration_s
        Duration of the run in s. The step comes at 0.1 s (`STEP_TIME_S`).
    law, initial_state
        A control law that replaces the law of the scenario: see `Scenario.with_law`.

    Raises
    ------
    ParameterError
        The step is 0 or leaves the range of the knee, or ``duration_s`` is out of range.
    SimulationError
        The run diverges or leaves its range.

    Examples
    --------
    >>> import kneexo as kx
    >>> step = kx.step(size_deg=5.0).step
    >>> print(f"overshoot {step.overshoot_percent:.1f} %, settled in {step.settling_time_s:.2f} s")
    overshoot 2.7 %, settled in 0.47 s
    """
    scenario = as_scenario(scenario, law, initial_state)
    if start_deg is None:
        start_deg = run_middle_deg(scenario)
    if size_deg == 0.0:
        raise ParameterError("size_deg = 0 deg: must not be 0")
    if duration_s <= STEP_TIME_S:
        raise ParameterError(
            f"duration_s = {duration_s:g} s: must be > {STEP_TIME_S:g} s, the time of the step"
        )
    end_deg = start_deg + size_deg
    scenario.plant.knee.require_posture(start_deg, "start_deg")
    scenario.plant.knee.require_posture(end_deg, "start_deg + size_deg")
    reference = StepReference(start_deg=start_deg, end_deg=end_deg, time_s=STEP_TIME_S)
    values = {"initial_offset_m": 0.0, "simulation.duration_s": duration_s}
    return track(scenario.changed({"reference": reference, **values}))
