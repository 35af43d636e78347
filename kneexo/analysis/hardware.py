"""Hardware of the actuator: what it allows in closed form, and a scenario with other hardware.

What sets them, in closed form. The rod cannot move faster than R = ω_max D_m/(gear Ā), nor
accelerate faster than A = α_max D_m/(gear Ā) = R α_max/ω_max. Among all motions within both, the
trapezoid of speed has the largest fundamental at ω:

    gain = 4A/(π ω² a) · sin(min(ωR/A, π/2)),   a the amplitude of the reference.

- ωR/A small: 4R/(πωa); −3 dB at 0.2866 R/a, within 1 % while A > 7.3 R²/a.
- A < 0.73 R²/a: the speed limit is never reached; −3 dB at 0.2136 √(A/a), whatever R is.

So motor speed, displacement, gear and piston area count only as R, until the acceleration limit
takes over. No controller gets beyond; one that is slow stays below. Inside both limits the error
of the sliding-mode loop is that of `kneexo.analysis.error_model`, and βη must be what the delay of
the motor asks for, τ ω̂² |ẍ_d|: a faster pump needs another η, a faster motion another λ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import scipy

from kneexo.analysis.bandwidth import acceleration_bound_hz, rod_amplitude_m, rod_limits
from kneexo.analysis.frequency_response import MINUS_3_DB, require_sine
from kneexo.errors import ParameterError
from kneexo.parameters import RPM, Scenario, SlidingModeParameters
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
"""Hardware that is sized, by dotted path: name, unit shown, and SI to that unit."""


ONE_PERCENT_RATIO, ACCELERATION_ALONE_RATIO = 7.27, 0.73
"""A a/R² at which the acceleration limit takes 1 % of the bandwidth, and all of the speed's say."""


# ----------------------------------------------------------------------------- closed forms


def limited_gain(
    frequency_hz: float, *, speed_limit: float, acceleration_limit: float, amplitude: float
) -> float:
    """Largest fundamental gain that both limits allow (at most 1), for a sine in the rod.

    Limits and amplitude in the same unit of length; all arguments must be positive.
    """
    omega = 2.0 * math.pi * frequency_hz
    ramp = min(omega * speed_limit / acceleration_limit, 0.5 * math.pi)
    return min(1.0, 4.0 * acceleration_limit / (math.pi * omega**2 * amplitude) * math.sin(ramp))


def limited_bandwidth_hz(
    *, speed_limit: float, acceleration_limit: float, amplitude: float
) -> float:
    """Frequency in Hz at which `limited_gain` falls to 1/√2: no controller has more bandwidth.

    Raises `ParameterError` unless all three are finite and positive.
    """
    values = {
        "speed_limit": speed_limit,
        "acceleration_limit": acceleration_limit,
        "amplitude": amplitude,
    }
    for name, value in values.items():
        if not 0.0 < value < math.inf:
            raise ParameterError(f"{name} = {value:g}: must be finite and > 0")
    # sin(u) <= u puts it below that of the speed limit alone, sin(u) >= 2u/π above half the lower
    # of the two.
    alone = 4.0 * speed_limit / (math.pi * amplitude * MINUS_3_DB) / (2.0 * math.pi)
    low = 0.5 * min(alone, acceleration_bound_hz(acceleration_limit, amplitude))
    high = alone * (1.0 + 1e-9)

    def excess(frequency: float) -> float:
        return limited_gain(frequency, **values) - MINUS_3_DB

    return float(scipy.optimize.brentq(excess, low, high, xtol=1e-13 * low, rtol=1e-13))


def expected_bandwidth_hz(scenario: Scenario) -> float:
    """`limited_bandwidth_hz` of the scenario's limits and its own sine."""
    require_sine(scenario)
    speed, acceleration = rod_limits(scenario)
    return limited_bandwidth_hz(
        speed_limit=speed, acceleration_limit=acceleration, amplitude=rod_amplitude_m(scenario)
    )


def sliding_mode(scenario: Scenario) -> SlidingModeParameters:
    """The scenario's sliding-mode controller; `ParameterError` when it has another."""
    if scenario.controller.kind != "smc":
        raise ParameterError(f"controller.kind = {scenario.controller.kind}: must be smc")
    return scenario.controller


# -------------------------------------------------------------------------- other hardware


def scaled(scenario: Scenario, factors: Mapping[str, float]) -> Scenario:
    """The scenario with hardware values (paths of `HARDWARE`) times ``factors``.

    The controller knows: its nominal plant and its command limit change too, and η and Φ grow
    with the rod speed, so that βη stays the same share of the motor's authority and k/Φ stays.
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


def tuned(scenario: Scenario, gains: Mapping[str, float]) -> Scenario:
    """The scenario with ``lambda_per_s``, ``slope_per_s`` (k/Φ, by Φ) and ``observer_s`` (T_f)."""
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
