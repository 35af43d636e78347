"""Parameters of encoder, state estimator and controller."""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import model_validator

from kneexo.errors import ParameterError, shortened
from kneexo.parameters.device.law import Law
from kneexo.parameters.device.plant import RPM
from kneexo.parameters.fields.quantity import (
    Parameters,
    choice,
    ordered_limits,
    quantities,
    quantity,
)


class EncoderParameters(Parameters):
    """Rotary encoder AMT203-V on link 4."""

    counts_per_revolution: int = quantity(4096, "1", "Section 2: AMT203-V, 12 bit", ge=2, le=2**24)
    quantized: bool = choice(True, "False bypasses the quantizer, which linearization requires")
    mounting_error_rad: float = quantity(
        0.0,
        "rad",
        "assumption: true θ_4 minus calibrated θ_4; not in the paper",
        ge=-0.2,
        le=0.2,
    )
    phase_rad: float = quantity(
        0.0,
        "rad",
        "assumption: θ_4 at which a count begins, known from calibration; not in the paper",
        ge=0,
        le=2.0 * math.pi,
    )

    @property
    def resolution_rad(self) -> float:
        """Angle of one count in rad, or zero if the quantizer is bypassed."""
        return 2.0 * math.pi / self.counts_per_revolution if self.quantized else 0.0

    @property
    def offset_rad(self) -> float:
        """Offset in rad that the controller adds to a reading.

        The offset is the phase, plus half a count, minus the mounting error. Half a count, because
        an encoder rounds down: the error of a reading is then zero on average.
        """
        phase = self.phase_rad if self.quantized else 0.0
        return phase + 0.5 * self.resolution_rad - self.mounting_error_rad


class ObserverParameters(Parameters):
    """Third-order tracking observer of rod position, velocity and acceleration."""

    kind: Literal["observer"] = "observer"
    time_constant_s: float = quantity(
        0.020,
        "s",
        "assumption: T_f; the paper does not say how velocity and acceleration are measured",
        ge=1e-5,
        le=10,
    )


class DifferenceParameters(Parameters):
    """Estimator that computes rod velocity and acceleration from differences of past positions."""

    kind: Literal["difference"] = "difference"


class ExactParameters(Parameters):
    """No estimator: the controller receives the plant's exact rod position, velocity, acceleration.

    The paper's simulation has no estimator either.
    """

    kind: Literal["exact"] = "exact"


def sample_time() -> Any:
    """Make the field of a controller's sample time in s."""
    return quantity(0.002, "s", "Table 3: interrupt time", ge=1e-5, le=1)


def command_limit() -> Any:
    """Make the field of a controller's limit of the speed command in rad/s."""
    return quantity(
        5000.0 * RPM,
        "rad/s",
        "Table 2: u <= 5000 rpm; the motor's own limit holds where it is lower",
        ge=1e-3,
        le=1e12,
    )


def anti_windup() -> Any:
    """Return the field for the time constant of the anti-windup of an integral."""
    return quantity(
        0.1, "s", "assumption: tracking time constant of back-calculation", ge=1e-5, le=1e3
    )


def stable_anti_windup() -> Any:
    """Make a validator: the time constant of the anti-windup is at least the sample time."""

    def check(parameters: Any) -> Any:
        if parameters.anti_windup_s < parameters.sample_time_s:
            raise ValueError(
                f"anti_windup_s = {parameters.anti_windup_s:g} s must be at least sample_time_s = "
                f"{parameters.sample_time_s:g} s"
            )
        return parameters

    return model_validator(mode="after")(check)


class SlidingModeParameters(Parameters):
    """Sliding-mode controller (Eq. 20–27)."""

    kind: Literal["smc"] = "smc"
    sample_time_s: float = sample_time()
    continuous: bool = choice(
        False, "True: continuous time, as in the ideal simulation of Fig. 9; needs exact states"
    )
    switching: Literal["saturation", "signum"] = choice(
        "saturation", "sat of Eq. 27, or sgn of Eq. 24 to show chattering"
    )
    lambda_per_s: float = quantity(
        20.0, "1/s", "assumption: λ is not in the paper", ge=1e-3, le=1e4
    )
    phi_m_s2: float = quantity(
        3.2, "m/s²", "assumption: Φ is not in the paper; k/Φ = 1e5 1/s", ge=1e-6, le=1e9
    )
    eta_m_s3: float = quantity(
        2.8e5,
        "m/s³",
        "assumption: η is not in the paper; β·η is the full speed authority",
        ge=0,
        le=1e12,
    )
    mass_min_kg: float = quantity(1.4, "kg", "Table 2", ge=0.01, le=1000)
    mass_max_kg: float = quantity(1.8, "kg", "Table 2", ge=0.01, le=1000)
    stiffness_uncertainty_n_per_m: float = quantity(
        0.0, "N/m", "assumption: ΔK_max of Eq. 27 is not in the paper", ge=0, le=1e7
    )
    damping_uncertainty_n_s_per_m: float = quantity(
        0.0, "N/(m/s)", "assumption: ΔB_max of Eq. 27 is not in the paper", ge=0, le=1e6
    )
    load_rate_uncertainty_n_per_s: float = quantity(
        0.0, "N/s", "assumption: bound on dF_L/dt in Eq. 27 is not in the paper", ge=0, le=1e9
    )
    area_uncertainty: float = quantity(
        0.0,
        "1",
        "Eq. 27 has no such term: bound on |A/Ā − 1|, the deviation of the area of a chamber from "
        "the mean area; 1/7 covers A_1 and A_2 of Table 3",
        ge=0,
        le=1,
    )
    command_limit_rad_s: float = command_limit()

    _ordered = ordered_limits()

    @property
    def mass_estimate_kg(self) -> float:
        """Geometric mean of the mass bounds, m̂ = √(m_min m_max) (Table 2), in kg."""
        return math.sqrt(self.mass_min_kg * self.mass_max_kg)

    @property
    def gain_ratio(self) -> float:
        """Ratio β = √(b_max/b_min) = √(m_max/m_min) of Eq. 23, which the paper prints inverted."""
        return math.sqrt(self.mass_max_kg / self.mass_min_kg)


class PidParameters(Parameters):
    """PID controller of the knee angle. The controller's output is a motor speed."""

    kind: Literal["pid"] = "pid"
    sample_time_s: float = sample_time()
    proportional_per_s: float = quantity(
        5.0,
        "1/s",
        "assumption: PID gains are not in the paper; 5 1/s gives the error of Fig. 12",
        ge=0,
        le=1e4,
    )
    integral_per_s2: float = quantity(0.0, "1/s²", "assumption: not in the paper", ge=0, le=1e6)
    derivative: float = quantity(
        0.0, "1", "assumption: not in the paper; gain on the error's rate", ge=0, le=1e4
    )
    filter_s: float = quantity(
        0.020,
        "s",
        "assumption: time constant of the error's filter for P and D; that of the observer, "
        "because both filter the same encoder",
        ge=1e-4,
        le=10,
    )
    anti_windup_s: float = anti_windup()
    velocity_feedforward: float = quantity(
        0.0, "1", "assumption: share of the reference's rate that is fed forward", ge=0, le=2
    )
    moment_arm_m: float = quantity(
        0.1,
        "m",
        "assumption: moment arm that turns a knee rate into a rod speed (mid-range of Table 1)",
        ge=1e-3,
        le=2,
    )
    command_limit_rad_s: float = command_limit()

    _stable = stable_anti_windup()


class LawParameters(Parameters):
    """A control law of the user in place of kneexo's laws.

    ``function`` is a function, a Drake system, or a class or function that makes a Drake system.
    ``function`` can also be the name ``FILE.py:NAME`` of a law. In a scenario file, FILE.py lies
    beside or below that file. Then the law is imported, and its values are checked, when the law is
    used first, by `loaded`.

    The law reads the signals of `kneexo.parameters.device.law.LAW_INPUTS` whose names are arguments
    of the function, or input ports of the system. A function may have the arguments ``time_s`` and
    ``state`` too. An argument with a number as default is a gain. ``values`` contains all gains.
    ``--set`` and uncertainty sets reach a gain by the path ``controller.values.NAME``.

    A function with the argument ``scenario`` makes a Drake system. Its scenario contains only what
    a controller knows: nominal plant, polynomial, encoder, estimator and controller. All its other
    arguments are gains.

    A function returns the motor speed in rad/s, where a positive speed drives the rod out, so that
    the knee angle falls. With the argument ``state`` the function returns the motor speed and the
    next state. The default of this argument is the initial state, unless ``initial_state`` is
    given. The function is called once a sample. The command is limited to
    ``command_limit_rad_s`` and held.
    """

    kind: Literal["law"] = "law"
    function: Law = choice(..., "given by the user: FILE.py:NAME of a function or Drake system")
    initial_state: tuple[float, ...] = quantities(
        (),
        "",
        "given by the user: `state` of the law at the start",
        min_length=None,
    )
    values: dict[str, float] = choice({}, "given by the user: gains of the law, by argument")
    sample_time_s: float = quantity(
        0.002, "s", "given by the user: the controller's period, that of the log", ge=1e-5, le=1
    )
    command_limit_rad_s: float = quantity(
        5000.0 * RPM,
        "rad/s",
        "given by the user; the default is that of the other controllers",
        ge=1e-3,
        le=1e12,
    )

    def __hash__(self) -> int:
        """Return a hash of all fields. A mapping is hashed as a sorted tuple."""
        values = (getattr(self, name) for name in type(self).model_fields)
        return hash(tuple(tuple(sorted(v.items())) if isinstance(v, dict) else v for v in values))

    def loaded(self) -> LawParameters:
        """Return the parameters with all gains and the initial state, after the law is imported.

        Raises `ParameterError` if the file of the law fails, or if a value does not suit the law.
        """
        law = self.function
        if law.takes_scenario or not law.is_system:
            present = self.values.keys(), bool(self.initial_state)
            if present == (law.arguments.gains.keys(), "state" in law.arguments.names):
                return self
        copy = self.model_copy()
        try:
            copy._complete()
        except ValueError as error:
            raise ParameterError(str(error)) from None
        return copy

    @model_validator(mode="after")
    def _suits_the_function(self) -> LawParameters:
        if self.function.is_loaded:  # else a scenario file names the law
            self._complete()
        return self

    def _complete(self) -> None:
        law = self.function
        if law.is_system and not law.takes_scenario:
            if self.initial_state or self.values:
                raise ValueError(
                    f"law {law.short_name} is a Drake system: initial_state and values must be "
                    f"left out; the system has its states and parameters"
                )
            return
        arguments = law.arguments
        if not self.initial_state:
            object.__setattr__(self, "initial_state", arguments.initial_state)
        has_state = "state" in arguments.names
        if has_state and not self.initial_state:
            raise ValueError(
                f"law {law.short_name} has the argument state: initial_state is missing, such as "
                f"[0.0]; or give the argument a default, state=(0.0,)"
            )
        if self.initial_state and not has_state:
            raise ValueError(
                f"initial_state = {list(self.initial_state)}: law {law.short_name} has no argument "
                f"state; add the argument, or leave out initial_state"
            )
        for name in self.values:
            if name not in arguments.gains:
                known = ", ".join(arguments.gains) or "none"
                raise ValueError(
                    f"values.{shortened(name)}: law {law.short_name} has no argument of this name "
                    f"with a number as default; known: {known}"
                )
        object.__setattr__(self, "values", arguments.gains | self.values)
