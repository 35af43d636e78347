"""Loops that several tests of the linear analysis share."""

import numpy as np
import pytest
from linear_cases import SCENARIOS, STABLE, eq_27
from scipy.interpolate import CubicSpline

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.parameters import G1


@pytest.fixture(scope="module")
def rod_of_knee(compass):
    """Rod extension of G1 as a function of the knee angle, by compass and ruler."""
    walk = compass(G1, np.radians(np.linspace(82.6, -4.8, 4001)))
    return CubicSpline(walk.knee_angle, walk.rod_extension)


@pytest.fixture(scope="session")
def loops():
    return {name: linearize_loop(scenario) for name, scenario in SCENARIOS.items()}


@pytest.fixture(scope="session")
def unstable():
    return linearize_loop(eq_27(1.3e4))


@pytest.fixture(scope="session")
def margins(loops):
    return {name: loops[name].margins() for name in STABLE}
