"""Bounds that the actuator's hardware sets on the bandwidth, and scenarios with other hardware.

Let ω_max be the largest speed of the motor, α_max its largest acceleration, D_m the displacement of
the pump and Ā the mean piston area. Then the largest speed of the rod is R = ω_max D_m/(gear Ā),
and its largest acceleration is A = α_max D_m/(gear Ā) = R α_max/ω_max. Of all motions within these
two limits, a trapezoidal speed profile has the largest fundamental. For a reference of amplitude a
and angular frequency ω its gain is

    gain = 4A/(π ω² a) · sin(min(ωR/A, π/2)).

- For small ωR/A the gain is 4R/(πωa), and the −3 dB frequency is 0.2866 R/a. The error of this
  frequency is below 1 % if A > 7.3 R²/a. The bandwidth then depends on motor speed, displacement,
  gear and piston area only through R.
- If A < 0.73 R²/a, the motion never reaches the speed limit, and the −3 dB frequency is
  0.2136 √(A/a).

No controller exceeds this gain. While rod speed and acceleration stay below their limits,
`kneexo.studies.size.error_model` gives the error of the sliding-mode loop. The delay τ of the motor
causes a disturbance τ ω̂² |ẍ_d|, for which the gain βη must compensate. A faster pump therefore
requires another η, and a faster motion another λ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import scipy

from kneexo.analysis.frequency.bandwidth import acceleration_bound_hz, rod_amplitude_m, rod_limits
from kneexo.analysis.frequency.frequency_response import require_sine
from kneexo.errors import ParameterError
from kneexo.parameters import RPM, Scenario, SlidingModeParameters
from kneexo.parameters.criteria import MINUS_3_DB
from kneexo.parameters.paths import changed, value_at

DISPLACEMENT = "plant.pump.displacement_m3_per_rad"
"""Path of the pump's displacement (m³/rad) in a scenario."""
ACCELERATION_LIMIT = "plant.pump.acceleration_limit_rad_s2"
"""Path of the motor's acceleration limit (rad/s²) in a scenario."""
SPEED_LIMIT = "plant.pump.speed_limit_rad_s"
"""Path of the motor's speed limit (rad/s) in a scenario."""

HARDWARE = {
    SPEED_LIMIT: ("motor speed limit", "rpm", 1.0 / RPM),
    DISPLACEMENT: ("pump displacement", "cm³/rev", 2e6 * math.pi),
    "plant.pump.gear_ratio": ("gear ratio", "", 1.0),
    ACCELERATION_LIMIT: ("acceleration limit", "rad/s²", 1.0),
    "plant.pump.lag_s": ("drive lag", "ms", 1e3),
    "encoder.counts_per_revolution": ("encoder", "counts/rev", 1.0),
}
"""For each dotted path of a hardware value: name, displayed unit, factor from SI to this unit."""

ONE_PERCENT_RATIO, ACCELERATION_ALONE_RATIO = 7.2666, 0.73
"""Two values of A a/R² for the speed limit R, acceleration limit A and amplitude a of the rod.

At `ONE_PERCENT_RATIO` the acceleration limit reduces the bandwidth by 1 %. Below
`ACCELERATION_ALONE_RATIO` the bandwidth does not depend on the speed limit.
"""


# ----------------------------------------------------------------------------- closed forms


def limited_gain(
    frequency_hz: float, *, speed_limit: float, acceleration_limit: float, amplitude: float
) -> float:
    """Return the largest gain, at most 1, that limits of rod speed and acceleration allow.

    The reference of the rod is a sine with the ``amplitude``. The amplitude and the two limits must
    have the same unit of length, such as m, m/s and m/s². All arguments must be positive.
    """
    omega = 2.0 * math.pi * frequency_hz
    ramp = min(omega * speed_limit / acceleration_limit, 0.5 * math.pi)
    return min(1.0, 4.0 * acceleration_limit / (math.pi * omega**2 * amplitude) * math.sin(ramp))


def limited_bandwidth_hz(
    *, speed_limit: float, acceleration_limit: float, amplitude: float
) -> float:
    """Return the frequency in Hz at which `limited_gain` is 1/√2, an upper bound of the bandwidth.

    Raises `ParameterError` unless all arguments are finite and positive.
    """
    values = {
        "speed_limit": speed_limit,
        "acceleration_limit": acceleration_limit,
        "amplitude": amplitude,
    }
    for name, value in values.items():
        if not 0.0 < value < math.inf:
            raise ParameterError(f"{name} = {value:g}: must be finite and > 0")
    # By sin(u) <= u the result lies below the −3 dB frequency of the speed limit alone. By
    # sin(u) >= 2u/π it lies above half the smaller of the −3 dB frequencies of both limits.
    alone = 4.0 * speed_limit / (math.pi * amplitude * MINUS_3_DB) / (2.0 * math.pi)
    low = 0.5 * min(alone, acceleration_bound_hz(acceleration_limit, amplitude))
    high = alone * (1.0 + 1e-9)

    def excess(frequency: float) -> float:
        return limited_gain(frequency, **values) - MINUS_3_DB

    return float(scipy.optimize.brentq(excess, low, high, xtol=1e-13 * low, rtol=1e-13))


def expected_bandwidth_hz(scenario: Scenario) -> float:
    """Return `limited_bandwidth_hz` for the limits and the sinusoidal reference of a scenario.

    Raises `ParameterError` when the reference is not a sine or does not move.
    """
    require_sine(scenario)
    speed, acceleration = rod_limits(scenario)
    return limited_bandwidth_hz(
        speed_limit=speed, acceleration_limit=acceleration, amplitude=rod_amplitude_m(scenario)
    )


def sliding_mode(scenario: Scenario) -> SlidingModeParameters:
    """Return the sliding-mode controller of a scenario. Raise `ParameterError` for another kind."""
    if scenario.controller.kind != "smc":
        raise ParameterError(f"controller.kind = {scenario.controller.kind}: must be smc")
    return scenario.controller


# -------------------------------------------------------------------------- other hardware


def scaled(scenario: Scenario, factors: Mapping[str, float]) -> Scenario:
    """Multiply hardware values of a scenario by ``factors`` and return the new scenario.

    ``factors`` maps a path of `HARDWARE` to a factor. The number of encoder counts is rounded. The
    controller follows: if the scenario has its own nominal plant (the model in the controller),
    the same factors apply to it. The command limit is multiplied by the factor of the motor speed
    limit. η and Φ of a sliding-mode controller are multiplied by the ratio of the new to the old
    largest rod speed. So k/Φ does not change, with k = βη, nor does the ratio of k to the largest
    rod speed.
    """
    values: dict[str, Any] = {}
    for path, factor in factors.items():
        value = value_at(scenario, path) * factor
        values[path] = round(value) if path == "encoder.counts_per_revolution" else value
        if scenario.nominal is not None and path.startswith("plant."):
            nominal_path = path.replace("plant", "nominal", 1)
            values[nominal_path] = value_at(scenario, nominal_path) * factor
        if path == SPEED_LIMIT:
            values["controller.command_limit_rad_s"] = scenario.command_limit_rad_s * factor
    other = changed(scenario, values)
    control = other.controller
    if control.kind != "smc":
        return other
    authority = rod_limits(other)[0] / rod_limits(scenario)[0]
    return changed(
        other,
        {
            "controller.eta_m_s3": control.eta_m_s3 * authority,
            "controller.phi_m_s2": control.phi_m_s2 * authority,
        },
    )


def with_piston(scenario: Scenario, factor: float) -> Scenario:
    """Return a scenario with ``factor`` times the areas of the piston and the pump's displacement.

    The limits of rod speed and acceleration do not change. The oil is stiffer by the factor, and so
    is the rod's jerk per motor speed. η, a jerk too, is multiplied by the factor, so that the
    commands do not change.
    """
    diameters = dict.fromkeys(
        ("plant.cylinder.bore_m", "plant.cylinder.rod_diameter_m"), math.sqrt(factor)
    )
    volumes = dict.fromkeys(("plant.cylinder.total_volume_m3", DISPLACEMENT), factor)
    other = scaled(scenario, diameters | volumes)
    if other.controller.kind != "smc":
        return other
    return changed(other, {"controller.eta_m_s3": other.controller.eta_m_s3 * factor})


def tuned(scenario: Scenario, gains: Mapping[str, float]) -> Scenario:
    """Return a scenario with other gains of the sliding-mode controller.

    ``gains`` must contain ``lambda_per_s`` (λ), ``slope_per_s`` (k/Φ) and ``observer_s`` (time
    constant T_f of the observer). Φ is changed to give this k/Φ. Raises `ParameterError` if the
    controller is of another kind.
    """
    control = sliding_mode(scenario)
    phi = control.gain_ratio * control.eta_m_s3 / gains["slope_per_s"]
    return changed(
        scenario,
        {
            "controller.lambda_per_s": gains["lambda_per_s"],
            "controller.phi_m_s2": phi,
            "estimator.time_constant_s": gains["observer_s"],
        },
    )
