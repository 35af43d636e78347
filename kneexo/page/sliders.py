"""The numbers that a user of a page can vary, with label, range and reason of the range.

A slider covers the values that show an effect. The range that a field allows is much wider.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from kneexo.parameters.device.control import (
    EncoderParameters,
    ObserverParameters,
    PidParameters,
    SlidingModeParameters,
)
from kneexo.parameters.device.plant import (
    RPM,
    BldcPumpParameters,
    CylinderParameters,
    FullCylinderParameters,
    KneeLoadParameters,
)
from kneexo.parameters.device.protection import ProtectionParameters
from kneexo.parameters.device.torque import TorqueParameters
from kneexo.parameters.fields.fields import limits_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.task.push import PushParameters
from kneexo.parameters.task.reference import RampReference, SineReference, StepReference
from kneexo.parameters.wearer.wearer import CuffParameters, LegParameters


@dataclass(frozen=True)
class Slider:
    """Label, range and scale of a number that a user varies."""

    label: str
    low: float
    high: float
    why: str
    """The reason for the range."""
    scale: Literal["linear", "log"] = "linear"
    shown: tuple[str, float] | None = None
    """Unit on the page, and the factor from the unit of the field; None: the unit of the field."""
    choices: tuple[str, ...] = ()
    """Values of ``mode`` or ``motion`` with which the number has an effect; empty for all."""
    main: bool = False
    """Whether the page shows the slider at once; `sliders_of` takes it from `MAIN`."""

    def quantity(self, name: str, value: float, unit: str, source: str) -> dict[str, Any]:
        """Return the number ``name`` as data of the page, within a range that includes ``value``.

        ``unit`` is that of ``value``. ``source`` is the origin of the value in words.
        """
        shown_unit, factor = self.shown or (unit, 1.0)
        return {
            "name": name,
            "label": self.label,
            "unit": unit,
            "shown_unit": shown_unit,
            "shown_factor": factor,
            "low": min(self.low, value),
            "high": max(self.high, value),
            "value": value,
            "scale": self.scale,
            "source": source,
            "help": self.why and f"range: {self.why}",
            "main": self.main,
        }


_FREE = ("active", "passive")
_RPM = ("rpm", 1.0 / RPM)
_MS = ("ms", 1e3)
_BAR = ("bar", 1e-5)
_DEG = ("deg", 180.0 / math.pi)
_CC_REV = ("cc/rev", 2e6 * math.pi)
_DECADE = "a factor of about ten around the paper's value"
_ALARM = "false alarms to hardly a detection"
LEAKAGE = ("cm³/(s·bar)", 1e11)
"""Unit of a leakage on the page, and the factor from m³/(s·Pa)."""
_LEAK = "from none to ten times the assumed leakage of the pump"

SLIDERS: Mapping[type[Parameters], Mapping[str, Slider]] = {
    BldcPumpParameters: {
        "gear_ratio": Slider("gear ratio", 1.0, 20.0, _DECADE, "log"),
        "speed_limit_rad_s": Slider(
            "speed limit of the motor",
            500 * RPM,
            5000 * RPM,
            "a tenth of the paper's limit to the limit of the command; no effect above it",
            "log",
            _RPM,
        ),
        "lag_s": Slider(
            "time constant of the motor", 0.002, 0.1, "quick to slow speed loops", "log", _MS
        ),
        "acceleration_limit_rad_s2": Slider(
            "acceleration limit of the motor", 300.0, 1e5, "sluggish to almost unlimited", "log"
        ),
        "displacement_m3_per_rad": Slider(
            "displacement of the pump", 3e-8, 5e-7, "pumps of 0.2 to 3 cc/rev", "log", _CC_REV
        ),
        "internal_leakage_m3_per_s_pa": Slider(
            "internal leakage of the pump", 0.0, 2e-12, _LEAK, shown=LEAKAGE
        ),
        "external_leakage_m3_per_s_pa": Slider(
            "external leakage of the pump", 0.0, 2e-12, _LEAK, shown=LEAKAGE
        ),
    },
    CylinderParameters: {
        "mass_kg": Slider("moving mass", 1.2, 2.5, "the bounds of Table 2, widened"),
        "bulk_modulus_pa": Slider(
            "bulk modulus of the oil", 2e8, 2e9, "oil with air to stiff oil", "log", _BAR
        ),
        "damping_n_s_per_m": Slider(
            "damping of the rod", 0.0, 500.0, "from the paper's value to heavy viscous friction"
        ),
        "leakage_m3_per_s_pa": Slider("leakage of the piston", 0.0, 2e-12, _LEAK, shown=LEAKAGE),
        "stiffness_n_per_m": Slider(
            "stiffness on the rod", 0.0, 2000.0, "up to 300 N at the end of the stroke"
        ),
    },
    KneeLoadParameters: {
        "segment_mass_kg": Slider("mass of the shank", 0.0, 6.0, "none to a heavy leg with shoe"),
        "centre_of_mass_m": Slider("lever of the shank's weight", 0.05, 0.4, "within a shank"),
        "inertia_kg_m2": Slider("inertia about the knee", 0.01, 0.3, "up to a leg with shoe"),
        "knee_torque_n_m": Slider(
            "constant torque on the knee",
            -15.0,
            15.0,
            "about the torque of a raised shank's weight, in both directions",
        ),
        "disturbance_n": Slider(
            "force on the rod", -200.0, 200.0, "about a fifth of the rated force"
        ),
    },
    FullCylinderParameters: {
        "coulomb_friction_n": Slider(
            "seal friction", 0.0, 60.0, "none to 1.5 times the preset leg"
        ),
        "relief_pressure_pa": Slider(
            "relief pressure", 1.2e6, 7e6, "a third to twice the rating", "log", _BAR
        ),
        "dead_volume_m3": Slider(
            "dead volume", 5e-6, 5e-5, "short to long hoses", "log", ("cm³", 1e6)
        ),
        "entrained_air": Slider("entrained air", 0.0, 0.03, "up to twice the common 1.5 %"),
    },
    SlidingModeParameters: {
        "lambda_per_s": Slider("λ, slope of the sliding surface", 2.0, 100.0, _DECADE, "log"),
        "phi_m_s2": Slider("Φ, boundary layer", 0.1, 100.0, "chattering to sluggish", "log"),
        "eta_m_s3": Slider("η, reaching rate", 1e3, 1e7, "weak to saturated", "log"),
        "area_uncertainty": Slider(
            "assumed area deviation", 0.0, 0.3, "1/7 covers the areas of both chambers"
        ),
    },
    PidParameters: {
        "proportional_per_s": Slider("P gain", 0.5, 100.0, "sluggish to unstable", "log"),
        "integral_per_s2": Slider("I gain", 0.0, 100.0, "none to unstable"),
        "derivative": Slider("D gain", 0.0, 0.5, "none to unstable"),
        "filter_s": Slider(
            "filter of the error", 0.004, 0.1, "two samples to five times the default", "log", _MS
        ),
        "velocity_feedforward": Slider("velocity feedforward", 0.0, 1.2, "none to 20 % too much"),
    },
    ObserverParameters: {
        "time_constant_s": Slider(
            "time constant of the observer", 0.004, 0.1, "two samples to sluggish", "log", _MS
        ),
    },
    EncoderParameters: {
        "mounting_error_rad": Slider(
            "mounting error of the encoder",
            -0.05,
            0.05,
            "about ±3°",
            shown=_DEG,
        ),
    },
    TorqueParameters: {
        "stiffness_n_m_per_rad": Slider(
            "virtual stiffness",
            0.0,
            300.0,
            "none to the stiffness of a leg in stance",
            choices=("impedance", "assist_as_needed"),
        ),
        "damping_n_m_s_per_rad": Slider(
            "virtual damping", 0.0, 20.0, "none to a stiff damper", choices=("impedance",)
        ),
        "band_rad": Slider(
            "band without torque", 0.0, 0.35, "none to 20°", "linear", _DEG, ("assist_as_needed",)
        ),
        "assistance": Slider(
            "share of assistance", -0.5, 1.0, "resistance to full help", choices=("assist",)
        ),
        "torque_limit_n_m": Slider(
            "limit of the desired torque",
            1.0,
            100.0,
            "light help to the largest moment of walking",
            "log",
            choices=("assist", "impedance", "assist_as_needed"),
        ),
        "proportional_rad_s_per_n": Slider("P gain on the force", 0.2, 40.0, _DECADE, "log"),
        "integral_rad_s2_per_n": Slider("I gain on the force", 0.0, 100.0, "none to unstable"),
        "leak_per_s": Slider("leak of the integral", 0.0, 10.0, "none to a tenth of a second"),
        "speed_feedforward": Slider("speed feedforward γ", 0.0, 1.0, "none to full"),
    },
    LegParameters: {
        "inertia_kg_m2": Slider(
            "inertia of the leg", 0.1, 1.5, "a child's leg to a leg with load", choices=_FREE
        ),
        "stiffness_n_m_per_rad": Slider(
            "stiffness of the leg", 2.0, 100.0, "relaxed to tense", "log", choices=_FREE
        ),
        "damping_n_m_s_per_rad": Slider(
            "damping of the leg", 0.0, 5.0, "none to tense", choices=_FREE
        ),
    },
    CuffParameters: {
        "stiffness_n_m_per_rad": Slider(
            "stiffness of the cuff", 200.0, 2e4, "soft straps to a rigid shell", "log"
        ),
        "damping_n_m_s_per_rad": Slider(
            "damping of the cuff", 0.0, 20.0, "none to four times the default"
        ),
    },
    PushParameters: {
        "torque_n_m": Slider(
            "torque of the push", -150.0, 150.0, "beyond the torque that opens the relief valves"
        ),
        "start_s": Slider("start of the push", 0.0, 60.0, "within a run"),
        "duration_s": Slider("duration of the push", 0.01, 5.0, "a knock to a hold", "log"),
    },
    ProtectionParameters: {
        "following_deg": Slider("threshold of following", 0.2, 30.0, _ALARM, "log"),
        "speed_rpm": Slider("threshold of speed", 20.0, 4000.0, _ALARM, "log"),
        "flow_mm": Slider("threshold of flow", 0.2, 25.0, _ALARM, "log"),
        "rate_deg_s": Slider("threshold of rate", 50.0, 1e4, _ALARM, "log"),
        "range_deg": Slider("threshold of range", 0.1, 30.0, _ALARM, "log"),
    },
    SineReference: {
        "amplitude_deg": Slider("amplitude", 1.0, 44.0, "within the range of motion"),
        "frequency_hz": Slider(
            "frequency", 0.02, 5.0, "slow bending to above the bandwidth", "log"
        ),
        "mean_deg": Slider("mean", 5.0, 85.0, "within the range of motion"),
        "ramp_s": Slider("time to full amplitude", 0.0, 10.0, "none to a slow start"),
    },
    StepReference: {
        "start_deg": Slider("start", 1.0, 89.0, "within the range of motion"),
        "end_deg": Slider("end", 1.0, 89.0, "within the range of motion"),
        "time_s": Slider("time of the step", 0.0, 10.0, "early in a run"),
    },
    RampReference: {
        "start_deg": Slider("start", 1.0, 89.0, "within the range of motion"),
        "end_deg": Slider("end", 1.0, 89.0, "within the range of motion"),
        "rate_deg_s": Slider(
            "rate", 1.0, 200.0, "slow bending to far above the motor's limit", "log"
        ),
        "time_s": Slider("start of the motion", 0.0, 10.0, "early in a run"),
    },
}
"""For each class of parameters, its fields that have a slider, the most important first."""


MAIN: Mapping[type[Parameters], Collection[str]] = {
    BldcPumpParameters: ("gear_ratio", "speed_limit_rad_s", "lag_s"),
    CylinderParameters: ("mass_kg", "bulk_modulus_pa", "leakage_m3_per_s_pa"),
    KneeLoadParameters: ("segment_mass_kg", "centre_of_mass_m"),
    FullCylinderParameters: ("coulomb_friction_n",),
    SlidingModeParameters: ("lambda_per_s", "phi_m_s2"),
    PidParameters: ("proportional_per_s", "integral_per_s2", "derivative"),
    TorqueParameters: (
        "stiffness_n_m_per_rad",
        "damping_n_m_s_per_rad",
        "band_rad",
        "assistance",
        "proportional_rad_s_per_n",
        "speed_feedforward",
    ),
    LegParameters: ("inertia_kg_m2", "stiffness_n_m_per_rad"),
    CuffParameters: ("stiffness_n_m_per_rad", "damping_n_m_s_per_rad"),
    PushParameters: ("torque_n_m", "start_s", "duration_s"),
    ProtectionParameters: ("following_deg", "speed_rpm", "flow_mm"),
    SineReference: ("amplitude_deg", "frequency_hz", "mean_deg"),
    StepReference: ("start_deg", "end_deg"),
    RampReference: ("start_deg", "end_deg", "rate_deg_s"),
}
"""The fields whose sliders the page shows at once. The others are below "more values"."""


def sliders_of(parameters: Parameters, path: str = "") -> Iterator[tuple[str, Slider]]:
    """Yield the dotted path and the slider of each number in ``parameters`` that has a slider.

    ``path`` is the path of ``parameters`` with a dot at its end, or empty. A number that is left
    out, or that has no effect, has no slider. The range of a slider includes the present value, and
    lies within the range of the field. The nominal plant has no sliders, because only the
    controller's design uses it.
    """
    fields = type(parameters).model_fields
    for name, slider in SLIDERS.get(type(parameters), {}).items():
        value, choices = getattr(parameters, name), slider.choices
        acts = not choices or any(choice in choices for choice in vars(parameters).values())
        if value is None or not acts:
            continue
        low, high = limits_of(fields[name])
        low, high = max(low, min(slider.low, value)), min(high, max(slider.high, value))
        scale = "linear" if low <= 0.0 else slider.scale
        main = name in MAIN.get(type(parameters), ())
        yield f"{path}{name}", replace(slider, low=low, high=high, scale=scale, main=main)
    for name in fields:
        part = getattr(parameters, name)
        if isinstance(part, Parameters) and name not in ("nominal", "reference"):
            yield from sliders_of(part, f"{path}{name}.")
