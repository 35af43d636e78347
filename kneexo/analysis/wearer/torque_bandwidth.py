"""Response of the rod force to the force that the torque controller desires."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from kneexo.analysis.frequency.frequency_response import crossing
from kneexo.analysis.linear.plant_linearization import MID_RANGE_DEG, Complex, frequency_array
from kneexo.analysis.signals import unwrapped_deg
from kneexo.analysis.wearer.impedance import (
    ROD_STATES,
    posed,
    torque_controller,
    wearer_model,
    with_prescribed_leg,
)
from kneexo.common.plotting import BLUE, TEAL, axes_or_new, label_bode
from kneexo.common.result import Array, Result
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario
from kneexo.parameters.criteria import MINUS_3_DB

Held = Literal["rod", "leg", "nothing"]
"""The part that does not move, ``rod``, ``leg`` (the other side of the cuff) or ``nothing``."""


@dataclass(frozen=True, repr=False)
class TorqueResponse(Result):
    """Response F/F_d of the rod force to the desired force, for small forces.

    ``response`` is complex, (n,), at the n ``frequency_hz``: the fundamental of F for a sine in
    F_d. At ``bandwidth_hz`` the gain first falls to 1/√2. The bandwidth is nan if the gain does not
    fall so far, if the gain begins below 1/√2, and if the loop is not ``stable``.
    """

    frequency_hz: Array
    response: Complex
    bandwidth_hz: float
    held: Held
    stable: bool
    scenario: Scenario

    def plot(self, ax: Any = None) -> Any:
        """Plot gain and phase of F/F_d; return two Matplotlib axes."""
        caption = (
            f"Gain and phase of the rod force relative to the desired force, with {self.held} held."
        )
        ax = axes_or_new(ax, 2, 1, caption=caption, sharex=True, figsize=(7, 6))
        f = self.frequency_hz
        ax[0].semilogx(f, 20.0 * np.log10(np.abs(self.response)), BLUE)
        ax[0].axhline(20.0 * np.log10(MINUS_3_DB), color="0.5", ls="--", lw=1)
        ax[1].semilogx(f, unwrapped_deg(self.response), BLUE)
        if np.isfinite(self.bandwidth_hz):
            label = f"−3 dB at {self.bandwidth_hz:.3g} Hz"
            for axis in ax:
                axis.axvline(self.bandwidth_hz, color=TEAL, ls="--", lw=1, label=label)
            ax[0].legend(loc="lower left")
        label_bode(ax, "gain (dB)")
        return ax


def torque_response(
    scenario: Scenario,
    frequency_hz: ArrayLike | None = None,
    *,
    knee_angle_deg: float = MID_RANGE_DEG,
    held: Held = "leg",
) -> TorqueResponse:
    """Compute the response of the rod force to the desired force, and its −3 dB bandwidth.

    The sampled loop is linearized as in `kneexo.analysis.wearer.impedance`. For the controller a
    change of the desired force equals the opposite change of the reading.

    Parameters
    ----------
    scenario
        A scenario with ``controller.kind = torque``, and with ``wearer.kind = leg`` unless
        ``nothing`` is held.
    frequency_hz
        Ascending frequencies in Hz, (n,), among which the bandwidth is searched. By default 400
        frequencies from 0.01 Hz to 98 % of half the sampling rate.
    knee_angle_deg
        Angle of the leg in deg.
    held
        The part that does not move, ``rod``, ``leg`` or ``nothing``. With ``nothing`` the leg
        moves according to its inertia, stiffness and damping. Without a wearer the bare shank
        moves, and the force only accelerates the mass of the shank, F = m dv/dt. A constant torque
        carries the weight of the shank, so that the loop rests at the angle.

    Raises
    ------
    ParameterError
        The scenario has no wearer or another controller, or ``held`` is unknown.
    LinearizationError
        The loop does not rest at the angle.
    """
    if held not in ("rod", "leg", "nothing"):
        raise ParameterError(f"held = {held!r}: must be rod, leg or nothing")
    if held == "nothing":
        scenario = posed(scenario, knee_angle_deg)
    else:
        scenario = with_prescribed_leg(scenario, "torque_response")
    law = torque_controller(scenario, "torque_response")
    if frequency_hz is None:
        frequency_hz = np.geomspace(0.01, 0.49 / law.sample_time_s, 400)
    f = frequency_array(frequency_hz)
    model, _ = wearer_model(scenario, knee_angle_deg, ("load_cell:measured_force",), ("rod_force",))
    if held == "rod":
        model = model.prescribed(ROD_STATES)
    response = np.asarray(-model.sine_response(f)[:, 0, 0], dtype=complex)
    bandwidth = crossing(f, np.abs(response)) if model.stable else float("nan")
    return TorqueResponse(f, response, bandwidth, held, model.stable, scenario)
