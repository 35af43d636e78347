"""Responses and bandwidths that are known in closed form."""

import json
import math

import pytest

PERIOD_S = 0.002

RESPONSES = """(() => {
  const [f, gain, phase, drift, start] = [%r, %r, %r, %r, %r];
  const size = Math.floor((start + 4 / f) / %r + 1e-6) + 1;
  const w = 2 * Math.PI * f;
  const at = (tick) => tick * %r;
  const wanted = (t) => 0.7 - 0.5 * Math.cos(w * t);
  const measured = (t) =>
    0.6 - 0.5 * gain * Math.cos(w * t + phase) + drift * t + 0.02 * Math.sin(3 * w * t);
  const [angle, reference] = [measured, wanted].map((signal) =>
    Float64Array.from({ length: size }, (_, tick) => signal(at(tick))));
  return SineSweep.cycleResponses(%r, angle, reference, f, start, 4);
})()"""


@pytest.mark.parametrize("frequency", [0.5, 0.7123, 11.37])  # also cycles of no whole sample
def test_the_response_has_no_part_of_mean_drift_and_harmonics(worker, frequency):
    gain, phase, drift = 0.8, -0.6, 0.01
    numbers = (frequency, gain, phase, drift, 0.5, PERIOD_S, PERIOD_S, PERIOD_S)
    for x, y in worker.evaluate(RESPONSES % numbers):
        assert abs(complex(x, y)) == pytest.approx(gain, rel=1e-4)
        assert math.atan2(y, x) == pytest.approx(phase, abs=1e-4)


def first_fall(worker, known, near):
    """The frequency and the number of measurements for a gain of 1/(1 + f²)."""
    script = f"""(async () => {{
      let count = 0;
      const excess = async (x) => (count++, Math.log(Math.SQRT2 / (1 + Math.exp(2 * x))));
      const known = {json.dumps(known)};
      for (const point of known) point.push(await excess(point[0]));
      count = 0;
      return [await SineSweep.firstFall(excess, known, Math.log({near}), Math.log(50)), count];
    }})()"""
    return worker.evaluate(script)


@pytest.mark.parametrize("near", [0.03, 0.7, 20.0])
@pytest.mark.parametrize("frequencies", [[], [0.1, 0.5, 3.0], [0.1, 0.2], [2.0, 5.0]])
def test_the_first_fall_is_found_from_anywhere(worker, near, frequencies):
    found, _ = first_fall(worker, [[math.log(f)] for f in frequencies], near)
    assert found == pytest.approx(math.sqrt(math.sqrt(2.0) - 1.0), rel=1e-3)


def test_points_that_enclose_the_fall_save_measurements(worker):
    _, count = first_fall(worker, [[math.log(0.5)], [math.log(0.8)]], 20.0)
    assert count <= 4


def test_a_gain_that_never_falls_has_no_bandwidth(worker):
    script = "SineSweep.firstFall(async () => 0.1, [], 0, Math.log(50))"
    assert worker.evaluate(script) is None
    script = "SineSweep.firstFall(async () => -0.1, [], 0, Math.log(50))"
    assert worker.evaluate(script) is None
