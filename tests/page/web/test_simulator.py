"""Maps, limits and metrics of runs; the truth of whole runs is in test_worker.py."""

import json
import math

import numpy as np
import pytest

VALUES = {"a": 1.7, "b": 0.4, "limit": 3.0}


def parameters_of(worker, *maps):
    part = {"base": [9.0] * 3, "maps": list(maps)}
    return worker.evaluate(f"[...Simulator.parametersOf({json.dumps(part)}, {json.dumps(VALUES)})]")


@pytest.mark.parametrize(
    ("kind", "numbers", "value"),
    [
        ("affine", {"offset": 3.0, "factors": [2.0, -1.0]}, 3.0 + 2.0 * 1.7 - 0.4),
        ("power", {"factor": 3.0, "exponents": [2.0, -1.0]}, 3.0 * 1.7**2 / 0.4),
        ("affine", {"offset": 3.0, "factors": [-2.0, 0.0], "at_least": 0.5}, 0.5),
        ("affine", {"offset": 4.0, "factors": [-2.0, 0.0], "at_least": 0.5}, 0.6),
        ("least", {"limit": 100.0, "factors": [2.0, 10.0]}, 2.0 * 1.7),
        ("least", {"limit": 1.0, "factors": [2.0, 10.0]}, 1.0),
        ("least", {"limit": None, "factors": [5.0, 10.0]}, 10.0 * 0.4),
        ("least", {"limit": None, "factors": [5.0, 10.0], "unit": 0.3}, 3.9),
    ],
)
def test_a_map_sets_its_parameter_alone(worker, kind, numbers, value):
    map_ = {"index": 1, "of": ["a", "b"], "kind": kind, **numbers}
    assert parameters_of(worker, map_) == pytest.approx([9.0, value, 9.0], rel=1e-14)


def test_a_chebyshev_series_of_two_values(worker):
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=(7, 4))
    domain = [[1.0, 2.0], [-3.0, 5.0]]
    terms = [[float(coefficients[i, j]), i, j] for i in range(7) for j in range(4)]
    map_ = {"index": 0, "of": ["a", "b"], "kind": "chebyshev", "domain": domain, "terms": terms}
    places = [
        (2.0 * VALUES[n] - low - high) / (high - low)
        for n, (low, high) in zip("ab", domain, strict=True)
    ]
    value = np.polynomial.chebyshev.chebval2d(*places, coefficients)
    assert parameters_of(worker, map_)[0] == pytest.approx(value, rel=1e-13)


def test_a_quantity_without_a_value_is_named(worker):
    map_ = {"index": 0, "of": ["unknown.name"], "kind": "affine", "offset": 0, "factors": [1]}
    part = json.dumps({"base": [0.0], "maps": [map_]})
    script = f"""(() => {{
      try {{ return Simulator.parametersOf({part}, {{}}); }}
      catch (error) {{ return error.message; }}
    }})()"""
    assert worker.evaluate(script) == "unknown.name has no value"


def test_a_limit_is_a_number_a_quantity_a_map_or_none(worker):
    limits = {
        "command_limit_rad_s": {"of": ["a"], "kind": "affine", "offset": 0, "factors": [2]},
        "motor_speed_limit_rad_s": "limit",
        "pressure_rating_pa": 5.0,
        "relief_pressure_pa": None,
    }
    script = f"Simulator.limitsOf({json.dumps({'limits': limits})}, {json.dumps(VALUES)})"
    assert worker.evaluate(script) == {
        "command_limit_rad_s": 3.4,
        "motor_speed_limit_rad_s": 3.0,
        "motor_acceleration_limit_rad_s2": math.inf,
        "pressure_rating_pa": 5.0,
        "relief_pressure_pa": math.inf,
    }


def test_the_values_of_a_request_replace_the_defaults(worker):
    quantities = [{"name": "a", "value": 1.0}, {"name": "b", "value": 2.0}]
    reference = {"sine": {"quantities": [{"name": "c", "value": 3.0}]}}
    model = json.dumps({"quantities": quantities, "references": reference})
    script = f"Simulator.valuesOf({model}, 'sine', {{b: 5, c: 6}})"
    assert worker.evaluate(script) == {"a": 1.0, "b": 5.0, "c": 6.0}


def test_the_worst_time_counts_from_the_fault_and_is_none_before_it(worker):
    signals = {"time": [0, 1, 2], "state": [0, 0, 0], "reason": [0, 0, 0], "speed": [1, 1, 1]}
    signals |= {"angle": [0, 0, 0], "error": [9, 1, -3], "kneeTorque": [9, 2, 1]}
    arrays = ", ".join(f"{name}: new Float64Array({values})" for name, values in signals.items())
    names = "{names: ['operating', 'stopped', 'released'], standstill_rad_s: 1}"
    script = f"[1, 2.5].map((start) => Simulator.protectionMetrics({{{arrays}}}, {names}, start))"
    after, before = worker.evaluate(script)
    assert [after["worst_time_s"], before["worst_time_s"]] == [2.0, None]
    assert [after["largest_error_rad"], after["torque_n_m"]] == [3.0, 2.0]


def test_parts_come_when_the_view_is_full_and_then_rarely_and_not_shortly_before_the_end(worker):
    """A run of 10 s of which one second takes 20 ms."""
    script = """((view) => {
      const { performance } = globalThis;
      let now = 5;
      const set = (value) =>
        Object.defineProperty(globalThis, "performance", { value, configurable: true });
      set({ now: () => now });
      const isDue = Simulator.partsOf({ ticks: 1000, table: { sample_time_s: 0.01 } }, view);
      const due = [];
      for (let tick = 10; tick < 1000; tick += 10) {
        now = 5 + 0.2 * tick;
        if (isDue(tick)) due.push(tick / 100);
      }
      set(performance);
      return due; })"""
    for view, due in (
        ([0, 10], [0.8]),
        ([0, 0.5], [0.5]),
        ([0, 3], [0.8, 3.0]),
        ([5, 6], [5.1, 6.0]),
    ):
        assert worker.evaluate(f"{script}({json.dumps(view)})") == due, view
    assert worker.evaluate(f"{script}([9, 10])") == []
