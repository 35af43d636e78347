"""Clauses about a run, which the lines of a verdict and the page to play with say alike."""

from __future__ import annotations

from kneexo.parameters.criteria import SETTLING_BAND
from kneexo.parameters.device.safety_states import DETECTORS, REASONS
from kneexo.parameters.task.reference import GaitReference

_ERROR = "largest error {max_error_deg:.3g}° at {max_error_time_s:.4g} s; the bound is "
_BAND = f"within {100.0 * SETTLING_BAND:g} % of the step of {{step_deg:.3g}}°"

CLAUSES = {
    "tracks": f"Tracks: {_ERROR}{{error_bound_deg:.3g}}°",
    "does not track": f"Does not track: {_ERROR}{{error_bound_deg:.3g}}°",
    "settles": f"Tracks: {_BAND} from {{settling_time_s:.3g}} s after it",
    "does not settle": f"Does not track: not {_BAND} at the end",
    "rises": "; rise time {rise_time_s:.3g} s",
    "does not rise": "; does not reach 90 %",
    "overshoots": ", overshoot {overshoot_percent:.2g} %, final error {final_error_deg:.3g}°",
    "hunts": "Hunts at rest: the reference is constant from {start_s:.4g} s on, and the knee moves "
    "±{amplitude_deg:.3g}° with a period of {period_s:.3g} s",
    "push": "The push moves the knee by {largest_deviation_deg:.3g}°",
    "wearer": "Interaction torque {rms_torque_n_m:.3g} N·m rms, peak {peak_torque_n_m:.3g} N·m",
    "stopped": "Stopped at {time_s:.4g} s by the {cause}",
    "after the fault": ", {stop_ms:.4g} ms after the fault",
    "safe after the fault": "; safe {safe_ms:.4g} ms after the fault",
    "safe": "; safe {safe_ms:.4g} ms after it",
    "not safe": "; the motor is not safe when the run ends",
    "until safe": ". Until then the knee turns {turn_deg:.3g}° at up to {torque_n_m:.3g} N·m",
    "bandwidth": "−3 dB at {bandwidth_hz:.3g} Hz; walking needs at least "
    f"{GaitReference().frequency_hz:g} Hz",
}
"""Templates of ``str.format`` by name. A metric has the name of its field.

The page fills them from the numbers that it computes, and leaves out what a terminal adds.
"""

_NAMED = {name: f"detector {name}" for name in DETECTORS} | {"start": "overdue start"}

CAUSES = {reason: _NAMED.get(reason, reason) for reason in REASONS}
"""What stops a motor, in words, by the `REASONS`, in their order."""


def said(*names: str, **numbers: object) -> str:
    """Return the `CLAUSES` of these names one after the other, filled with ``numbers``."""
    return "".join(CLAUSES[name] for name in names).format(**numbers)
