"""Limit cycles at rest in signals that are made by hand."""

import math

import numpy as np
import pytest

from kneexo.analysis.tracking.limit_cycle import limit_cycle
from kneexo.parameters import Scenario
from kneexo.simulation import Run

TIME = np.arange(0.0, 20.0, 0.002)


def cycle_of(angle_deg, *, reference_deg=40.0, pressure_pa=0.0):
    """The limit cycle of a knee angle, which is constant or sampled."""
    columns = {
        "knee_reference_rad": np.radians(reference_deg),
        "knee_angle_rad": np.radians(angle_deg),
        "load_pressure_pa": pressure_pa,
    }
    data = {name: np.broadcast_to(values, TIME.shape) for name, values in columns.items()}
    return limit_cycle(Run(TIME, data, Scenario().simulation))


def test_a_sine_has_its_amplitude_period_and_pressure():
    phase = 2.0 * math.pi * TIME / 0.8
    reference = np.where(TIME < 3.0, 20.0, 40.0)
    early = np.where(TIME < 11.4, 9e5, 0.0)  # the first half of the rest from 3 to 20 s
    cycle = cycle_of(
        reference + 0.05 * np.sin(phase) + 0.02,
        reference_deg=reference,
        pressure_pa=early + 1e5 * np.cos(phase) - 2e5,
    )
    assert cycle.start_s == 3.0
    assert cycle.amplitude_deg == pytest.approx(0.05, rel=1e-4)
    assert cycle.period_s == pytest.approx(0.8, abs=5e-4)  # a sample in 10 periods
    assert cycle.lowest_pressure_mpa == pytest.approx(-0.3, rel=1e-3)
    assert cycle.highest_pressure_mpa == pytest.approx(-0.1, rel=1e-3)
    assert cycle.line == (
        "Hunts at rest: the reference is constant from 3 s on, and the knee moves ±0.05° with a "
        "period of 0.8 s, the load pressure from -0.3 to -0.1 MPa."
    )


def test_ripples_about_the_middle_do_not_count():
    phase = 2.0 * math.pi * TIME
    cycle = cycle_of(40.0 + 0.1 * np.sin(phase) + 0.03 * np.sin(31.0 * phase))
    assert cycle.period_s == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("angle_deg", "found"),
    [
        (40.0, False),
        (40.0 + 0.01 * TIME, False),  # drifts
        (40.0 + np.exp(-0.5 * TIME) * np.sin(9.0 * TIME), False),  # decays
        (40.0 + 0.01 * np.exp(0.1 * TIME) * np.sin(9.0 * TIME), True),  # grows
        (40.0 + 1.1e-3 * np.sin(9.0 * TIME), True),
        (40.0 + 0.9e-3 * np.sin(9.0 * TIME), False),
        (40.0 + np.sin(2.0 * math.pi * TIME / 4.7), True),  # two periods in the second half
        (40.0 + np.sin(2.0 * math.pi * TIME / 11.0), False),  # not even one
    ],
)
def test_an_oscillation_that_lasts_is_found(angle_deg, found):
    assert (cycle_of(angle_deg) is not None) == found


def test_a_knee_that_follows_a_sine_does_not_rest():
    assert cycle_of(40.0 + np.sin(TIME), reference_deg=40.0 + np.sin(TIME)) is None
