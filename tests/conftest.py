"""Shared oracle: the four-bar linkage by compass and ruler, driven by link 4."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest


def _walk(link, theta_4):
    """Assemble along a path of θ_4 (rad) that starts at the extended knee.

    Joint A is where the circle of link 2 about O_A meets that of the coupler about B; of the two
    intersections the one whose knee angle starts nearest to zero is kept all along.
    """
    theta_4 = np.asarray(theta_4, dtype=float)
    o_a = link.o_a_x_m + 1j * link.o_a_y_m
    o_b = link.o_b_x_m + 1j * link.o_b_y_m
    b = o_b + link.a_4_m * np.exp(1j * theta_4)
    distance = np.abs(b - o_a)
    along = (link.a_2_m**2 - link.a_3_m**2 + distance**2) / (2.0 * distance)
    across = np.sqrt(link.a_2_m**2 - along**2)
    walks = []
    for side in (1j, -1j):
        a = o_a + (b - o_a) / distance * (along + side * across)
        theta_3 = np.unwrap(np.angle(b - a))
        knee = theta_3 + link.phi_rad
        knee = knee - 2.0 * np.pi * np.round(knee.flat[0] / (2.0 * np.pi))
        pin = b + link.rod_pin_radius_m * np.exp(1j * (theta_3 + link.rod_pin_angle_rad))
        anchor = link.rod_anchor_radius_m * np.exp(1j * link.rod_anchor_angle_rad)
        walks.append(
            SimpleNamespace(
                theta_4=theta_4,
                theta_3=theta_3,
                knee_angle=knee,
                joint_a=a,
                joint_b=b,
                rod_pin=pin,
                rod_extension=np.abs(pin - anchor) - link.rod_length_m,
            )
        )
    return min(walks, key=lambda walk: abs(walk.knee_angle.flat[0]))


@pytest.fixture(scope="session")
def compass():
    """The function ``compass(link, theta_4)``: joints, knee angle and rod along a path."""
    return _walk


@pytest.fixture(autouse=True)
def _no_figure_stays_open():
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")
