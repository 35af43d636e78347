"""Load cell and torque controller."""

import math

import pytest

from kneexo.parameters import (
    BldcPumpParameters,
    CuffParameters,
    CylinderParameters,
    LoadCellParameters,
    TorqueParameters,
)


def test_default_gains_meet_the_low_frequency_limit_of_passivity() -> None:
    law, pump, cylinder = TorqueParameters(), BldcPumpParameters(), CylinderParameters()
    # Gains in flow per force; (1 − γ)(C_t + k_p) ≥ k_i (τ_m + γT/2), in pressure.
    flow = pump.displacement_m3_per_rad / pump.gear_ratio * cylinder.mean_area_m2
    k_p, k_i = law.proportional_rad_s_per_n * flow, law.integral_rad_s2_per_n * flow
    gamma, leakage = law.speed_feedforward, pump.internal_leakage_m3_per_s_pa
    assert (1.0 - gamma) * (leakage + k_p) >= k_i * (pump.lag_s + gamma * 0.001)


def test_default_gains_cross_over_at_7_hz_behind_the_default_cuff() -> None:
    law, pump, cylinder = TorqueParameters(), BldcPumpParameters(), CylinderParameters()
    arm = 0.1021  # at 45 deg
    rod_per_motor = pump.displacement_m3_per_rad / pump.gear_ratio / cylinder.mean_area_m2
    oil = 4.0 * cylinder.bulk_modulus_pa * cylinder.mean_area_m2**2 / cylinder.total_volume_m3
    cuff = CuffParameters().stiffness_n_m_per_rad / arm**2
    stiffness = 1.0 / (1.0 / oil + 1.0 / cuff)
    crossover = law.proportional_rad_s_per_n * rod_per_motor * stiffness / math.tau
    assert crossover == pytest.approx(7.0, abs=0.1)


def test_seeds_of_the_generator_are_whole_and_in_its_range() -> None:
    seen = [LoadCellParameters(seed=seed).generator_seeds for seed in range(200)]
    assert len(set(seen)) == 200
    for seeds in seen:
        for seed, modulus in zip(seeds, (30269, 30307, 30323), strict=True):
            assert seed == int(seed)
            assert 1 <= seed < modulus
