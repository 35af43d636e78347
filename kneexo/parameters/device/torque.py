"""Parameters of the load cell and of the torque controller."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import model_validator

from kneexo.parameters.device.control import (
    anti_windup,
    command_limit,
    sample_time,
    stable_anti_windup,
)
from kneexo.parameters.fields.quantity import Parameters, choice, quantity

AS_183 = ((30269, 171), (30307, 172), (30323, 170))
"""Moduli and multipliers of the random generator of Wichmann and Hill, Algorithm AS 183 (1982)."""


def generator_seeds(seed: int) -> tuple[float, ...]:
    """Return initial states of the three generators of `AS_183`, whole numbers >= 1."""
    words = np.random.SeedSequence(seed).generate_state(len(AS_183)).tolist()
    return tuple(
        float(word % (modulus - 1) + 1) for word, (modulus, _) in zip(words, AS_183, strict=True)
    )


class LoadCellParameters(Parameters):
    """Load cell on the rod, in a loop with a wearer or a torque controller."""

    range_n: float = quantity(
        2000.0, "N", "assumption: 1.8 times the rated pressure on A_1", ge=1, le=1e6
    )
    filter_s: float = quantity(
        0.001, "s", "assumption: low-pass of the amplifier, 159 Hz", ge=1e-5, le=1
    )
    offset_n: float = quantity(0.0, "N", "assumption: none; zero is calibrated", ge=-1e5, le=1e5)
    noise_n: float = quantity(
        0.0, "N", "assumption: none; standard deviation of a sample", ge=0, le=1e4
    )
    seed: int | None = quantity(
        None, "1", "given by the user: number that selects the noise", ge=0, le=2**31 - 1
    )
    resolution_n: float = quantity(
        4000.0 / 4096.0, "N", "assumption: ±range_n by 12 bit", ge=1e-6, le=1e4
    )
    quantized: bool = choice(True, "False bypasses the quantizer, which linearization requires")
    dropout_s: float = quantity(
        0.0, "s", "assumption: none; time without new readings", ge=0, le=1e5
    )
    dropout_start_s: float = quantity(
        1.0, "s", "assumption: readings later than this time are missing", ge=0, le=1e5
    )

    @property
    def generator_seeds(self) -> tuple[float, ...]:
        """Initial states of the generators of `AS_183`, from ``seed``."""
        return generator_seeds(self.seed or 0)

    @model_validator(mode="after")
    def _noise_can_be_repeated(self) -> LoadCellParameters:
        if self.noise_n > 0.0 and self.seed is None:
            raise ValueError(
                f"noise_n = {self.noise_n:g} N: seed must be given, so that the run can be "
                f"repeated; add seed: 1"
            )
        return self


class TorqueParameters(Parameters):
    """Torque controller of the knee: PI on the rod force, with feedforward of the rod speed.

    The default gains suit a cuff of 1500 N·m/rad and the default observer. With each leg of
    `kneexo.parameters.wearer.wearer.WEARERS` the gain margin is at least 2. On a locked rod the
    loop gain is about 90 times larger, and the loop is unstable.
    """

    kind: Literal["torque"] = "torque"
    mode: Literal["zero_torque", "assist", "impedance", "assist_as_needed"] = choice(
        "zero_torque",
        "zero_torque; assist: a share of the biological moment; impedance: a virtual spring and "
        "damper about the reference; assist_as_needed: a virtual spring outside a band about it",
    )
    sample_time_s: float = sample_time()
    proportional_rad_s_per_n: float = quantity(
        4.0,
        "(rad/s)/N",
        "assumption: K_p D_m k_s/(i Ā r²) = 2π 7 Hz behind a cuff of 1500 N·m/rad, at 45°; with "
        "lags, integral and feedforward the loop at the command crosses one at 5.6 Hz",
        ge=0,
        le=1e4,
    )
    integral_rad_s2_per_n: float = quantity(
        20.0,
        "(rad/s²)/N",
        "assumption: about a tenth of the largest passive gain, "
        "k_i ≤ (1 − γ)(C_t + k_p)/(τ_m + γT/2 + (1 − γ)τ_F)",
        ge=0,
        le=1e6,
    )
    leak_per_s: float = quantity(
        5.0,
        "1/s",
        "assumption: rate at which the integral decays, for the phase margin of a relaxed leg",
        ge=0,
        le=100,
    )
    speed_feedforward: float = quantity(
        0.45,
        "1",
        "assumption: γ, share of the estimated rod speed; the gain margin is near 1/γ; γ = 1 with "
        "an integral is never passive",
        ge=0,
        le=1,
    )
    anti_windup_s: float = anti_windup()
    timeout_s: float = quantity(
        0.010,
        "s",
        "assumption: five samples; with an older reading of the load cell the motor is held",
        ge=1e-5,
        le=1e3,
    )
    torque_limit_n_m: float = quantity(
        30.0, "N·m", "assumption: limit of the desired torque", ge=0, le=500
    )
    assistance: float = quantity(
        0.2, "1", "assumption: share of the biological moment in the mode assist", ge=-1, le=1
    )
    stiffness_n_m_per_rad: float = quantity(
        20.0,
        "N·m/rad",
        "assumption: virtual stiffness; 1 N·m/deg is 57.3 N·m/rad",
        ge=0,
        le=1e6,
    )
    damping_n_m_s_per_rad: float = quantity(
        1.0, "N·m·s/rad", "assumption: virtual damping in the mode impedance", ge=0, le=1e3
    )
    band_rad: float = quantity(
        math.radians(5.0),
        "rad",
        "assumption: 5°, half the band without torque in the mode assist_as_needed",
        ge=0,
        le=2,
    )
    command_limit_rad_s: float = command_limit()

    _stable = stable_anti_windup()
