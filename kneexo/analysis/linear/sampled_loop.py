"""Exact linearization of the sampled-data loop, a continuous plant with a sampled controller.

`diagramc.linearize` gives the linear model. The quantizers of encoder and bus, whose derivatives
are zero, are left out. The linear loop is valid inside the boundary layer and the speed limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from diagramc import LinearModel, Transfer, linearize
from kneexo.analysis.linear.eigenvalue_plot import plot_eigenvalues
from kneexo.analysis.linear.loop_equilibrium import find_equilibrium
from kneexo.analysis.linear.margins import Margins, stability_margins
from kneexo.analysis.linear.plant_linearization import MID_RANGE_DEG, Complex, frequency_array
from kneexo.analysis.signals import unwrapped_deg
from kneexo.common.plotting import BLUE, GOLD, RED, TEAL, axes_or_new, label_bode
from kneexo.common.result import Array, Result
from kneexo.errors import LinearizationError
from kneexo.law.decision import makers_called_once
from kneexo.parameters import Scenario
from kneexo.parameters.criteria import MINUS_3_DB

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STATE_STEP = 1e-12
_JERK_STEP_RAD_S3 = 1e-3
"""Relative step of the states, and step of the reference's jerk in rad/s³.

The control law has a kink at the equilibrium. So gradients are computed these steps away from the
equilibrium, on its two sides. The steps exceed the rounding errors of the estimates and are
negligible relative to the width of the boundary layer.
"""


@dataclass(frozen=True, repr=False)
class SampledLoop(Result):
    """Linear closed loop of plant and sampled controller.

    The inputs of ``model`` are the reference that the controller reads (θ_d and three derivatives)
    and a perturbation of the motor speed command. The outputs of ``model`` are the port ``output``
    and the command. The state has the states of the plant and then the states of the controller, in
    the units of the Context.
    """

    model: LinearModel
    output: str
    knee_angle_rad: float
    scenario: Scenario

    @property
    def sample_time_s(self) -> float:
        """The sample time T in s."""
        return float(self.model.period_s or 0.0)

    @cached_property
    def moving(self) -> Any:
        """Indices of the states that change.

        An integral of a PID without integral action, for example, keeps its value.
        """
        rows = np.hstack([self.model.a, self.model.b])
        still = (rows - np.eye(*rows.shape), rows)  # keeps its value, or becomes a constant
        # The tolerance covers rounding of 1e-16.
        return np.flatnonzero(np.all([(np.abs(r) > 1e-12).any(axis=1) for r in still], axis=0))

    @property
    def monodromy(self) -> Array:
        """Matrix of the `moving` states from one sample to the next, for a constant reference."""
        return np.asarray(self.model.a[np.ix_(self.moving, self.moving)])

    @property
    def eigenvalues(self) -> Complex:
        """Eigenvalues of `monodromy` by falling magnitude.

        The loop is stable if all magnitudes are below 1. In a conjugate pair, the eigenvalue with
        positive imaginary part comes first. A state that never changes, such as the integral of a
        PID without integral action, adds no eigenvalue.
        """
        values = np.linalg.eigvals(self.monodromy).astype(complex)
        return values[np.argsort(-np.abs(values), kind="stable")]

    def poles(self) -> Complex:
        """Return the poles ln(z)/T in 1/s of the `eigenvalues` z, except for z = 0."""
        values = self.eigenvalues
        values = values[np.abs(values) > 1e-9]
        return np.asarray(np.log(values) / self.sample_time_s, dtype=complex)

    @property
    def stable(self) -> bool:
        """Whether every eigenvalue lies inside the unit circle."""
        return bool(np.abs(self.eigenvalues[0]) < 1.0)

    def to_control(self) -> Any:
        """Return the loop transfer L(z), for negative feedback, as a `control.StateSpace`.

        The sample time ``dt`` is T. The input is ``motor_speed_command_rad_s``, and the output is
        ``returned_command_rad_s``. The states have the same names as in ``model``.
        """
        import control

        loop = self.loop
        return control.ss(
            *(loop.a, loop.b, loop.c, loop.d, loop.period_s),
            name="loop",
            inputs=["motor_speed_command_rad_s"],
            outputs=["returned_command_rad_s"],
            states=[self.model.state_names[index] for index in self.moving],
        )

    @cached_property
    def loop(self) -> Transfer:
        """The loop transfer L, broken at the motor speed command, for negative feedback."""
        # The perturbation d adds to the command y after an update. For d = v − y the plant reads v.
        drive, row = self.model.b[self.moving, 4:], self.model.after_updates().c[1:, self.moving]
        return Transfer(self.monodromy - drive @ row, drive, -row, 0.0, self.sample_time_s)

    def loop_response(self, frequencies_hz: ArrayLike) -> Complex:
        """Return the loop transfer L(e^{j2πfT}) at frequencies f in Hz, (n,)."""
        return self.loop.response(frequency_array(frequencies_hz))

    def sensitivity(self, frequencies_hz: ArrayLike) -> Complex:
        """Return the sensitivity 1/(1 + L) of the loop transfer L, (n,), at frequencies in Hz."""
        return np.asarray(1.0 / (1.0 + self.loop_response(frequencies_hz)), dtype=complex)

    def complementary_sensitivity(self, frequencies_hz: ArrayLike) -> Complex:
        """Return the complementary sensitivity L/(1 + L), (n,), at frequencies in Hz."""
        loop = self.loop_response(frequencies_hz)
        return np.asarray(loop / (1.0 + loop), dtype=complex)

    def output_response(self, frequencies_hz: ArrayLike) -> Complex:
        """Return the response of the output to a sine in θ_d, at frequencies in Hz, (n,).

        The continuous output has components at ω + 2πk/T for all integers k. The result is the
        component at ω. The samples U e^{jωkT} of the command are held for T. The held command has
        the component U (1 − e^{−jωT})/(jωT) at ω, and the plant responds to this component with
        G(jω). The result is exact, also above the Nyquist frequency, if the law has no continuous
        states. The method gives such states the reference of the last sample. Raises
        `LinearizationError` unless all frequencies are positive.
        """
        f = frequency_array(frequencies_hz)
        if np.any(f <= 0.0):
            raise LinearizationError(f"frequency = {f.min():g} Hz: must be > 0")
        model, dt = self.model, self.sample_time_s
        # The compiler's `sine_response` would save these lines, but takes 100 times as long.
        s = 2j * np.pi * f[:, None, None]
        z = np.exp(s * dt)
        reference = np.concatenate([np.ones_like(s), s, s * s, s * s * s], axis=1)
        # After an update the state is J x + K r. Its discrete part is held until the next sample.
        (tick,) = model.ticks
        moves = tick.rate_state.any(axis=1)
        before = np.linalg.solve(z * np.eye(len(model.a)) - model.a, model.b[:, :4] @ reference)
        updated = tick.jump_state @ before + tick.jump_input[:, :4] @ reference
        held = updated[:, ~moves] * (1.0 - np.exp(-s * dt)) / (s * dt)
        rates = tick.rate_state[moves]
        shifted = s * np.eye(len(rates)) - rates[:, moves]
        plant = np.linalg.solve(shifted, rates[:, ~moves] @ held)
        response = model.c[:1, moves] @ plant + model.c[:1, ~moves] @ held
        return np.asarray(response, dtype=complex)[:, 0, 0]

    def bandwidth_hz(self) -> float:
        """Return the −3 dB bandwidth in Hz of `output_response`, for small signals.

        The bandwidth is the lowest frequency, up to the Nyquist frequency, at which the gain falls
        below 1/√2 times the gain at 0.01 Hz. The result is nan if the gain does not fall so far.
        The response contains the exact feedforward of the reference and its derivatives. So the
        gain can rise again at higher frequencies, or never fall.
        `complementary_sensitivity_bandwidth_hz` is the bandwidth of the feedback alone. Raises
        `LinearizationError` for an unstable loop.
        """
        return self._first_fall_hz(self.output_response)

    def complementary_sensitivity_bandwidth_hz(self) -> float:
        """Return the −3 dB bandwidth in Hz of `complementary_sensitivity`, L/(1 + L).

        The feedback alone, without feedforward, acts up to about this frequency. `bandwidth_hz`
        describes the definition, the range and the errors.
        """
        return self._first_fall_hz(self.complementary_sensitivity)

    def _first_fall_hz(self, response: Callable[[ArrayLike], Complex]) -> float:
        """Return the −3 dB frequency in Hz of ``response``, or nan, as `bandwidth_hz` describes."""
        self.require_stable("bandwidth")
        # 0.5 % apart: the first fall, which may be followed by a rise, is bracketed before the root
        # search.
        grid = np.geomspace(1e-2, 0.5 / self.sample_time_s, 2000)
        gain = np.abs(response(grid))
        threshold = MINUS_3_DB * gain[0]
        low = gain < threshold
        if not low.any():
            return math.nan
        index = int(np.argmax(low))

        def excess(frequency: float) -> float:
            return float(np.abs(response(frequency)[0])) - threshold

        return float(scipy.optimize.brentq(excess, grid[index - 1], grid[index]))

    def require_stable(self, what: str) -> None:
        """Raise `LinearizationError` if the loop is unstable and therefore lacks ``what``."""
        if not self.stable:
            raise LinearizationError(
                f"the sampled loop is unstable (largest eigenvalue "
                f"{abs(self.eigenvalues[0]):.6g} > 1): it has no {what}; reduce the gain"
            )

    def margins(self) -> Margins:
        """Return gain, phase, delay and disk margins up to the Nyquist frequency (`Margins`)."""
        return stability_margins(self.loop)

    def __str__(self) -> str:
        """Return stability, margins and bandwidths as text."""
        margins = self.margins()
        largest = abs(self.eigenvalues[0])
        head = (
            f"knee at {math.degrees(self.knee_angle_rad):.4g} deg, T = {self.sample_time_s:g} s: "
        )
        if not margins.stable:
            return head + f"unstable, largest eigenvalue {largest:.6g}; it has no margins"
        m = margins
        lower = f", lower {m.lower_gain_margin:.4g}" if m.lower_gain_margin > 0.0 else ""
        phase, delay, lead = "infinite", "infinite", ""
        if math.isfinite(m.phase_margin_deg):
            phase = f"{m.phase_margin_deg:.4g} deg at {m.phase_margin_frequency_hz:.4g} Hz"
            delay = f"{1e3 * m.delay_margin_s:.4g} ms"
        if m.phase_lead_margin_deg < 180.0:
            lead = (
                f", lead {m.phase_lead_margin_deg:.4g} deg at "
                f"{m.phase_lead_margin_frequency_hz:.4g} Hz"
            )
        return (
            head + f"stable, largest eigenvalue {largest:.6g}\n"
            f"  gain margin {m.gain_margin:.4g} at {m.gain_margin_frequency_hz:.4g} Hz{lower}\n"
            f"  phase margin {phase}{lead}, delay margin {delay}\n"
            f"  disk margin {m.disk_margin:.4g} at {m.disk_margin_frequency_hz:.4g} Hz: "
            f"gain {m.disk_gain_margin:.4g}, phase {m.disk_phase_margin_deg:.4g} deg\n"
            f"  small-signal bandwidth {self._in_hz(self.bandwidth_hz())}, with feedforward\n"
            f"  complementary sensitivity bandwidth "
            f"{self._in_hz(self.complementary_sensitivity_bandwidth_hz())}, feedback alone"
        )

    def _in_hz(self, bandwidth: float) -> str:
        """Return a bandwidth in Hz as text; for nan, "none below" and the Nyquist frequency."""
        if math.isnan(bandwidth):
            return f"none below {0.5 / self.sample_time_s:g} Hz"
        return f"{bandwidth:.4g} Hz"

    def plot(self, ax: Any = None) -> Any:
        """Plot magnitude and phase of L up to the Nyquist frequency; return two Matplotlib axes.

        The phase is unwrapped and starts between −270° and 90°. For a stable loop the plot also
        shows gain and phase margin.
        """
        caption = (
            "Bode plot of the loop transfer L up to the Nyquist frequency. "
            "Vertical bars show gain and phase margin of a stable loop."
        )
        ax = axes_or_new(ax, 2, 1, caption=caption, sharex=True, figsize=(7, 6))
        nyquist = 0.5 / self.sample_time_s
        f = self.frequency_grid()
        loop, margins = self.loop_response(f), self.margins()
        with np.errstate(divide="ignore"):  # a loop without gain gives −inf dB
            decibel = 20.0 * np.log10(np.abs(loop))
        phase = unwrapped_deg(loop)
        phase -= 360.0 * math.floor((phase[0] + 270.0) / 360.0)
        for axis, values in zip(ax, (decibel, phase), strict=True):
            axis.semilogx(f, values, BLUE)
            axis.axvline(nyquist, color="0.3", ls="--", lw=1, label=f"Nyquist, {nyquist:g} Hz")
        crossover = margins.phase_margin_frequency_hz
        if self.stable and math.isfinite(crossover):
            there = float(np.interp(crossover, f, phase))
            ax[0].plot([crossover], [0.0], ".", color=TEAL, label=f"crossover {crossover:.3g} Hz")
            ends = [there - margins.phase_margin_deg, there]
            label = f"phase margin {margins.phase_margin_deg:.3g}°"
            ax[1].plot([crossover] * 2, ends, ".-", color=TEAL, lw=2, label=label)
        if self.stable and math.isfinite(margins.gain_margin):
            at = margins.gain_margin_frequency_hz
            decibels = 20.0 * math.log10(margins.gain_margin)
            label = f"gain margin {margins.gain_margin:.3g} ({decibels:.3g} dB)"
            ax[0].plot([at] * 2, [-decibels, 0.0], ".-", color=GOLD, lw=2, label=label)
        ax[0].axhline(0.0, color="0.6", lw=0.8)
        ax[1].axhline(-180.0, color="0.6", lw=0.8)
        label_bode(ax, "loop magnitude (dB)")
        for axis in ax:
            axis.legend(loc="lower left")
        return ax

    def frequency_grid(self) -> Array:
        """Return frequencies in Hz for a plot, from 0.02 Hz to the Nyquist frequency.

        The frequencies (n,) ascend, and are dense around each lightly damped resonance.
        """
        nyquist = 0.5 / self.sample_time_s
        values = self.eigenvalues
        values = np.append(values, np.linalg.eigvals(self.loop.a))
        # A mode with |z| ≤ 0.5 is so damped that the coarse grid shows its resonance.
        modes = np.abs(np.angle(values[np.abs(values) > 0.5])) * nyquist / math.pi
        # A step of 1e-3 missed the resonances with a smaller damping ratio.
        offset = np.geomspace(1e-6, 0.1, 120)  # down to a damping ratio of 1e-5
        near = modes[:, None] * (1.0 + np.concatenate([-offset, [0.0], offset]))
        grid = np.concatenate([np.geomspace(0.02, nyquist, 2000), near.ravel()])
        return np.unique(grid[(grid >= 0.02) & (grid <= nyquist)])

    def plot_nyquist(self, ax: Axes | None = None) -> Axes:
        """Plot the Nyquist curve of the loop around −1, with the unit circle and the margin disk.

        The curve touches the disk of the balanced disk margin. The diameter of this disk is the
        interval −γ … −1/γ of the real axis, where γ = ``disk_gain_margin``. The loop stays stable
        if L is multiplied by any complex factor inside the disk with the diameter 1/γ … γ. No disk
        is drawn if the loop is unstable or the disk margin is 2 or more.
        """
        reach = 0.5 * self.margins().disk_margin if self.stable else math.nan
        caption = "Nyquist plot of the loop transfer L."
        if reach < 1.0:  # otherwise the disk is no circle; nan: an unstable loop
            caption += (
                " The curve touches the disk of the disk margin. This disk reaches from −γ to "
                "−1/γ, where 1/γ … γ are the allowed factors of the gain. So its centre lies "
                "left of −1."
            )
        ax = axes_or_new(ax, caption=caption, figsize=(5.5, 5.5))
        loop = self.loop_response(self.frequency_grid())
        ax.plot(loop.real, loop.imag, BLUE, lw=1.2, label="L, f > 0")
        ax.plot(loop.real, -loop.imag, BLUE, ls=":", lw=0.8, label="L, f < 0")
        circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
        ax.plot(circle.real, circle.imag, color="0.3", lw=0.8, label="|L| = 1")
        ax.plot([-1.0], [0.0], "+", color=RED, ms=9, mew=1.5, label="−1")
        if reach < 1.0:
            gain = (1.0 + reach) / (1.0 - reach)
            disk = -0.5 * (gain + 1.0 / gain) + 0.5 * (gain - 1.0 / gain) * circle
            label = f"disk margin {2.0 * reach:.3g}"
            ax.fill(disk.real, disk.imag, color=RED, alpha=0.25, lw=0, label=label)
        ax.legend(loc="upper right", fontsize=8)
        ax.set(xlabel="real part of L", ylabel="imaginary part of L")
        ax.set_aspect("equal")
        ax.set(xlim=(-3.5, 1.5), ylim=(-2.5, 2.5))
        ax.grid(alpha=0.3)
        return ax

    def plot_poles(self, ax: Axes | None = None) -> Axes:
        """Plot the eigenvalues in the z-plane, with unit circle and lines of constant damping.

        An inset enlarges the neighbourhood of z = 1 if several eigenvalues lie there, and if the
        inset hides no other eigenvalue.
        """
        caption = (
            "Eigenvalues of the sampled loop in the z-plane. "
            "Slow eigenvalues lie near z = 1, and the loop is stable if all lie inside the circle. "
            "ζ is the damping ratio on each grey line."
        )
        ax = axes_or_new(ax, caption=caption, figsize=(5.5, 5.5))
        plot_eigenvalues(ax, self.eigenvalues)
        return ax


@makers_called_once()
def linearize_loop(
    scenario: Scenario = Scenario(),
    *,
    knee_angle_deg: float = MID_RANGE_DEG,
    output: str = "knee_angle",
    law: Any = None,
    initial_state: Sequence[float] = (),
) -> SampledLoop:
    """Linearize the sampled-data loop of a scenario at its equilibrium for a constant reference.

    The quantizers of the scenario are bypassed.

    Parameters
    ----------
    scenario
        The loop. Its reference and initial offset have no effect.
    knee_angle_deg
        The constant reference in deg.
    output
        Name of an output port with one element. Its response to the reference is computed.
    law, initial_state
        A control law that replaces the law of ``scenario``: see `Scenario.with_law`.

    Raises
    ------
    LinearizationError
        The loop has no equilibrium. At the equilibrium the command is at its limit, or the sliding
        variable is outside the boundary layer. The controller is continuous or switches by signum.
        A derivative is not finite.
    """
    if law is not None:
        scenario = scenario.with_law(law, initial_state=initial_state)
    equilibrium = find_equilibrium(scenario, knee_angle_deg=knee_angle_deg)
    # The absolute values of Eq. 27 have a kink at the equilibrium. A small motion sees the mean of
    # the slopes on both sides; at the equilibrium itself rounding would choose one of them.
    jerk = np.array([0.0, 0.0, 0.0, _JERK_STEP_RAD_S3])
    model = linearize(
        equilibrium.equations,
        equilibrium.context,
        inputs=[equilibrium.reference, equilibrium.command],
        outputs=[output, equilibrium.command],
        beside=[equilibrium.beside(side * _STATE_STEP, side * jerk) for side in (-1.0, 1.0)],
    )
    return SampledLoop(
        model=model,
        output=output,
        knee_angle_rad=equilibrium.knee_angle_rad,
        scenario=scenario,
    )
