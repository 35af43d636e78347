"""Shared by the tests of the diagrams: a fixed-step Simulator and a linkage written anew."""

import cmath
import math

import pytest
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator


def make_fixed_step(diagram, scheme, step):
    simulator = Simulator(diagram)
    ResetIntegratorFromFlags(simulator, scheme, step)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    return simulator


@pytest.fixture
def fixed_step():
    """``fixed_step(diagram, scheme, step)``: a Simulator with that integrator at a fixed step."""
    return make_fixed_step


class FourBarOracle:
    """Geometry G1 by intersecting circles, in m and rad (Lee et al. 2020, Eq. 1–9).

    Joint A lies on the circle around O_A with radius a_2; the second circle follows from whichever
    angle is given. It shares neither code nor formula with `kneexo.geometry.linkage`.
    """

    o_a, o_b = complex(22.2063e-3, -34.732e-3), complex(-6.679e-3, -17.5701e-3)
    a_2, a_3, a_4 = 32.9701e-3, 17.0e-3, 18.2289e-3
    phi = math.radians(-167.0801)
    pin_radius, pin_angle = 265.8651e-3, math.radians(-62.9916)
    anchor = cmath.rect(118.1887e-3, math.radians(-97.3807))
    rod_length = 231.3769e-3

    def _joint_a(self, centre, radius, side):
        d = centre - self.o_a
        along = (self.a_2**2 - radius**2 + abs(d) ** 2) / (2.0 * abs(d))
        return self.o_a + d / abs(d) * (along + side * 1j * math.sqrt(self.a_2**2 - along**2))

    def theta_4(self, knee):
        """Encoder angle of a knee angle."""
        coupler = cmath.rect(self.a_3, knee - self.phi)
        joint_a = self._joint_a(self.o_b - coupler, self.a_4, -1.0)
        return cmath.phase(joint_a + coupler - self.o_b)

    def knee(self, theta_4):
        """Knee angle of an encoder angle (Eq. 3–7)."""
        joint_b = self.o_b + cmath.rect(self.a_4, theta_4)
        joint_a = self._joint_a(joint_b, self.a_3, -1.0)
        return cmath.phase((joint_b - joint_a) * cmath.rect(1.0, self.phi))

    def rod(self, knee):
        """Rod extension of a knee angle (Eq. 8, 9)."""
        theta_3 = knee - self.phi
        joint_b = self.o_b + cmath.rect(self.a_4, self.theta_4(knee))
        pin = joint_b + cmath.rect(self.pin_radius, theta_3 + self.pin_angle)
        return abs(pin - self.anchor) - self.rod_length

    def arm(self, knee):
        """Moment arm of the rod by virtual work: its moment about the centre of rotation.

        The coupler turns about the point where the lines of link 2 and link 4 meet. A pushing rod
        extends the knee, so its moment about this point is clockwise.
        """
        link_4 = cmath.rect(self.a_4, self.theta_4(knee))
        joint_b = self.o_b + link_4
        joint_a = joint_b - cmath.rect(self.a_3, knee - self.phi)
        link_2 = joint_a - self.o_a
        along = (link_2.conjugate() * (self.o_a - self.o_b)).imag
        centre = self.o_b + link_4 * along / (link_2.conjugate() * link_4).imag
        pin = joint_b + cmath.rect(self.pin_radius, knee - self.phi + self.pin_angle)
        rod = pin - self.anchor
        return -((pin - centre).conjugate() * rod).imag / abs(rod)

    def knee_of_rod(self, extension, guess=0.7):
        """Knee angle of a rod extension, by the secant method to machine precision."""
        a, b = guess, guess + 1e-3
        f_a, f_b = self.rod(a) - extension, self.rod(b) - extension
        for _ in range(50):
            if f_b == f_a or abs(b - a) < 1e-15:
                break
            a, b, f_a = b, b - f_b * (b - a) / (f_b - f_a), f_b
            f_b = self.rod(b) - extension
        return b


@pytest.fixture(scope="session")
def four_bar():
    return FourBarOracle()
