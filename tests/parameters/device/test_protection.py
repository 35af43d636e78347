"""Thresholds that cannot work are refused in one line."""

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import Scenario
from kneexo.parameters.device.safety_states import DETECTORS
from kneexo.parameters.fields.quantity import limits_of

WEARER = Scenario.preset("wearer")
NOISY = Scenario.preset("wearer").changed({"load_cell.noise_n": 2.0, "load_cell.seed": 1})
REFUSED = [
    ({"range_deg": 0.05}, {}, r"range_deg = 0.05 deg: must be > 0.08789 deg, one count of the enc"),
    ({"rate_deg_s": 40.0}, {}, r"rate_deg_s = 40 deg/s: must be > 43.95 deg/s, one count of the"),
    ({"following_deg": 0.08}, {}, r"following_deg = 0.08 deg: must be > 0.08789 deg, one count"),
    ({"flow_mm": 0.01}, {}, r"flow_mm = 0.01 mm: must be > 0.1465 mm, the mean travel of"),
    ({"speed_rpm": 0.5}, {"bus": "can"}, "speed_rpm = 0.5 rpm: must be > 1 rpm, one velocity unit"),
    ({"healthy_s": 2.0}, {}, "healthy_s = 2 s: must be at most overdue_s = 1 s"),
    ({"flow": 1.0}, {}, r"protection.flow: unknown name; did you mean protection.flow_"),
    (
        {"safe_state": "open"},
        {},
        r"safe_state = 'open': must be 'zero_speed', 'dynamic_brake', 'to",
    ),
    (
        {"safe_state": "bypass"},
        {},
        "safe_state = bypass: the plant has no bypass; must be another one, or add plant",
    ),
    *(
        ({"safe_state": name}, {}, f"safe_state = {name}: the plant has no motor; must be anothe")
        for name in ("dynamic_brake", "torque_off")
    ),
    (
        {},
        {"controller.continuous": True, "estimator.kind": "exact"},
        "protection: needs controller.continuous = false",
    ),
]


@pytest.mark.parametrize(("protection", "values", "message"), REFUSED)
def test_a_wrong_protection_is_one_line(protection, values, message):
    base = Scenario().changed(values)
    with pytest.raises(ParameterError, match=message) as error:
        base.changed({"protection": protection})
    assert "\n" not in str(error.value)


def test_the_threshold_of_the_load_cell_lies_between_its_noise_and_its_range():
    with pytest.raises(ParameterError, match=r"load_cell_n = 2000 N: must be < load_cell.range_n"):
        WEARER.changed({"protection": {"load_cell_n": 2000.0}})
    with pytest.raises(ParameterError, match="load_cell_n = 5 N: must be > 6 N, three stand"):
        NOISY.changed({"protection": {"load_cell_n": 5.0}})
    Scenario(protection={"load_cell_n": 2000.0})  # no load cell


def test_each_detector_has_a_threshold():
    fields = type(Scenario(protection={}).protection).model_fields
    for detector in DETECTORS.values():
        assert fields[detector.field].json_schema_extra["unit"] == detector.unit
        assert limits_of(fields[detector.field])[0] > 0.0
