"""Words, units and values of parameters as texts."""

import pytest

from kneexo.parameters.labels import labels, value_text


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("plant.cylinder.mass_kg", "mass (kg)"),
        ("plant.pump.internal_leakage_m3_per_s_pa", "internal leakage (m³/(s·Pa))"),
        ("plant.load.knee_torque_n_m", "knee torque (N·m)"),
        ("plant.pump.gear_ratio", "gear ratio"),
        ("bus.latency_samples", "latency (samples)"),
        ("controller.lambda_per_s", "λ (1/s)"),
        ("controller.phi_m_s2", "Φ (m/s²)"),
        ("plant.linkage", "linkage"),
        ("initial_offset_m", "initial offset (m)"),
        ("load_cell.offset_n", "load cell offset (N)"),
        ("wearer.cuff.stiffness_n_m_per_rad", "cuff stiffness (N·m/rad)"),
    ],
)
def test_a_label_has_words_and_the_unit_of_the_field(path, text):
    assert labels([path]) == {path: text}


def test_labels_of_values_with_the_same_words_begin_with_the_part():
    paths = ["plant.pump.lag_s", "plant.cylinder.mass_kg", "nominal.pump.lag_s", "bus.lag"]
    assert labels(paths) == {
        "plant.pump.lag_s": "plant pump lag (s)",
        "plant.cylinder.mass_kg": "mass (kg)",
        "nominal.pump.lag_s": "nominal pump lag (s)",
        "bus.lag": "bus lag",
    }


def test_one_more_part_is_enough_if_it_tells_the_values_apart():
    paths = ["plant.cylinder.mass_kg", "plant.load.mass_kg"]
    assert list(labels(paths).values()) == ["cylinder mass (kg)", "load mass"]


@pytest.mark.parametrize(
    ("path", "value", "text"),
    [
        ("plant.cylinder.bore_m", 0.01995, "0.01995"),
        ("plant.cylinder.bulk_modulus_pa", 1.72e9, "1.72e9"),
        ("plant.pump.acceleration_limit_rad_s2", 1e4, "10000"),
        ("encoder.mounting_error_rad", -0.0015339807878856412, "−0.001534"),
        ("bus.latency_samples", 2, "2"),
        ("plant.linkage", "G2", "G2"),
        ("plant.full_order", None, "off"),
        ("plant.full_order", {}, "on"),
        ("plant.full_order", {"coulomb_friction_n": 40.0}, "on, coulomb friction 40 N"),
        ("encoder.quantized", False, "off"),
        ("plant.cylinder", {"mass_kg": 1.5}, "mass 1.5 kg"),
    ],
)
def test_a_value_is_a_number_or_words(path, value, text):
    assert value_text(path, value) == text
