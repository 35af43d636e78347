"""Properties of linkages against loop closure by root finding, which shares no code with them."""

import re
from dataclasses import dataclass

import numpy as np
import pytest
from table_1 import changed

from kneexo.errors import LinkageError
from kneexo.geometry.linkage import pose
from kneexo.geometry.linkage_properties import (
    MOBILITY,
    assembly_limits,
    encoder_reversals,
    inversions,
    linkage_properties,
    rod_dead_centres,
)
from kneexo.parameters import G1, G3, G4, LINKAGES, LinkageParameters

MM = 1e-3
MIDDLE, HALF_TURN = np.pi / 4.0, np.pi
RANGE = np.radians(np.linspace(0.0, 90.0, 91))


# ------------------------------------------------------------------- the independent program


@dataclass
class Loops:
    """Loops of links as columns of arrays (n,), closed by Newton's method from a guess."""

    o_a: np.ndarray
    o_b: np.ndarray
    a_2: np.ndarray
    a_3: np.ndarray
    a_4: np.ndarray
    phi: np.ndarray
    branch: np.ndarray
    pin: np.ndarray
    anchor: np.ndarray

    @classmethod
    def of(cls, links):
        rows = [
            (
                complex(k.o_a_x_m, k.o_a_y_m), complex(k.o_b_x_m, k.o_b_y_m),
                k.a_2_m, k.a_3_m, k.a_4_m, k.phi_rad, k.branch,
                k.rod_pin_radius_m * np.exp(1j * k.rod_pin_angle_rad),
                k.rod_anchor_radius_m * np.exp(1j * k.rod_anchor_angle_rad),
            )
            for k in links
        ]  # fmt: skip
        return cls(*(np.array(column) for column in zip(*rows, strict=True)))

    def only(self, which):
        return Loops(*(column[which] for column in vars(self).values()))

    def close(self, angle, guess):
        """θ_2 and θ_4, (2, n), and whether Newton's method closed the loop on the branch."""
        coupler = self.a_3 * np.exp(1j * (angle - self.phi))
        theta = guess.copy()
        with np.errstate(all="ignore"):
            for _ in range(8):
                link_2, link_4 = self.a_2 * np.exp(1j * theta[0]), self.a_4 * np.exp(1j * theta[1])
                gap = self.o_a + link_2 + coupler - self.o_b - link_4
                if np.all(np.abs(gap) < 1e-15):
                    break
                span = (np.conj(link_2) * link_4).imag
                move = 1j * gap
                theta[0] += (np.conj(link_4) * move).imag / -span
                theta[1] += (np.conj(link_2) * move).imag / -span
            side = np.sign((np.conj(link_2) * link_4).imag)
        near = np.max(np.abs(theta - guess), axis=0) < 0.3
        return theta, (np.abs(gap) < 1e-13) & (side == self.branch) & near

    def start(self):
        """θ_2 and θ_4 at the middle: every angle of link 4 on a grid, then Newton's method."""
        grid = np.linspace(-np.pi, np.pi, 3601)[:, None]
        coupler = self.a_3 * np.exp(1j * (MIDDLE - self.phi))
        link_2 = self.o_b + self.a_4 * np.exp(1j * grid) - coupler - self.o_a
        miss = np.abs(np.abs(link_2) - self.a_2)
        side = np.sign((np.conj(link_2) * np.exp(1j * grid)).imag)
        best = np.argmin(np.where(side == self.branch, miss, np.inf), axis=0)
        guess = np.array([np.angle(link_2[best, np.arange(best.size)]), grid[best, 0]])
        theta, closed = self.close(MIDDLE, guess)
        assert closed.all()
        return theta

    def rod(self, angle, theta):
        pin = self.o_b + self.a_4 * np.exp(1j * theta[1]) + self.pin * np.exp(
            1j * (angle - self.phi)
        )  # fmt: skip
        return np.abs(pin - self.anchor)

    def rates(self, angle, theta):
        """Rates of rod and of link 4 by differences of closed loops, (2, n)."""
        step = 1e-6
        ahead, behind = (self.close(angle + h, theta)[0] for h in (step, -step))
        rod = self.rod(angle + step, ahead) - self.rod(angle - step, behind)
        return np.array([rod, ahead[1] - behind[1]]) / (2.0 * step)


def walked(loops, direction, largest):
    """Angles (m, n) and θ (m, 2, n) from the middle on, up to half a turn or to the limit.

    A step is halved until the loop closes on the branch, so that a walk ends 1e-9 rad before the
    limit of assembly. A walk that has ended stays where it is.
    """
    angle, theta = np.full(loops.a_2.shape, MIDDLE), loops.start()
    step = np.full(angle.shape, largest)
    angles, thetas = [angle], [theta]
    while np.any(moving := (step > 1e-9) & (np.abs(angle - MIDDLE) < HALF_TURN)):
        rest = HALF_TURN - np.abs(angle - MIDDLE)
        ahead = angle + direction * np.minimum(step, rest)
        found, closed = loops.close(ahead, theta)
        taken = moving & closed
        angle, theta = np.where(taken, ahead, angle), np.where(taken, found, theta)
        step = np.where(taken, np.minimum(2.0 * step, largest), np.where(moving, step / 2, step))
        angles.append(angle)
        thetas.append(theta)
    return np.array(angles), np.array(thetas)


def oracle(links, largest_deg):
    """Per linkage: (lower and upper end of the motion, dead centres, reversals), in rad."""
    loops = Loops.of(links)
    down, up = (walked(loops, sign, np.radians(largest_deg)) for sign in (-1.0, 1.0))
    angle = np.concatenate([down[0][:0:-1], up[0]])
    theta = np.concatenate([down[1][:0:-1], up[1]])
    # At its end a walk is too near to the limit for a difference across.
    inner = angle + np.where(angle < MIDDLE, 4e-6, -4e-6)
    rates = np.array([loops.rates(a, t) for a, t in zip(inner, theta, strict=True)])
    events = []
    for row in (0, 1):
        turns = np.diff(np.sign(rates[:, row]), axis=0) != 0.0
        turns &= np.diff(angle, axis=0) > 0.0
        events.append(refined(loops, inner, theta, turns, row))
    return list(zip(angle[0], angle[-1], *events, strict=True))


def refined(loops, angle, theta, turns, row):
    """Bisect the rate of rod (row 0) or link 4 (row 1) in each step of a walk that ``turns``."""
    step, which = np.nonzero(turns)
    those, near = loops.only(which), theta[step, :, which].T
    low, high = angle[step, which], angle[step + 1, which]
    start = those.rates(low, near)[row] > 0.0
    for _ in range(25):
        middle = 0.5 * (low + high)
        same = (those.rates(middle, near)[row] > 0.0) == start
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return [np.sort(low[which == n]) for n in range(loops.a_2.size)]


def random_links(count, seed):
    """Linkages that close at 45°, most of them not over 0…90°."""
    rng = np.random.default_rng(seed)
    links = []
    for _ in range(count):
        o_a, o_b = rng.uniform(-0.04, 0.04, 2), rng.uniform(-0.04, 0.04, 2)
        a_2, a_3, share = rng.uniform(0.01, 0.06), rng.uniform(0.01, 0.06), rng.uniform(0.1, 0.9)
        phi = rng.uniform(-np.pi, np.pi)
        gap = abs(complex(*o_b) - complex(*o_a) - a_3 * np.exp(1j * (MIDDLE - phi)))
        links.append(
            LinkageParameters(
                o_a_x_m=o_a[0], o_a_y_m=o_a[1], o_b_x_m=o_b[0], o_b_y_m=o_b[1],
                a_2_m=a_2, a_3_m=a_3, a_4_m=max(abs(gap - a_2), 1e-3) * (1 - share)
                + (gap + a_2) * share,
                phi_rad=phi, branch=int(rng.choice([-1, 1])),
                rod_pin_radius_m=rng.uniform(0.03, 0.3), rod_pin_angle_rad=rng.uniform(-3, 3),
                rod_anchor_radius_m=rng.uniform(0.1, 0.4), rod_anchor_angle_rad=rng.uniform(-3, 3),
            )
        )  # fmt: skip
    return links


def turning_joints(lengths):
    """Whether each joint of a loop of four links turns fully, by closing the loop at all angles."""
    turn = np.linspace(0.0, np.pi, 721)
    full = []
    for n in range(4):
        p, q, r, s = np.roll(lengths, -n)
        diagonal = np.abs(p - q * np.exp(1j * turn))
        full.append(bool(np.all((diagonal >= abs(r - s)) & (diagonal <= r + s))))
    return full  # the joints between ground and 2, 2 and 3, 3 and 4, 4 and ground


NAMES = {
    (True, False, False, True): ("double crank", "double rocker"),
    (False, True, True, False): ("double rocker", "double crank"),
    (True, True, False, False): ("crank rocker", "crank rocker"),
    (False, False, True, True): ("crank rocker", "crank rocker"),
    (False, False, False, False): ("triple rocker", "triple rocker"),
}


def lengths_of(link):
    ground = np.hypot(link.o_b_x_m - link.o_a_x_m, link.o_b_y_m - link.o_a_y_m)
    return np.array([ground, link.a_2_m, link.a_3_m, link.a_4_m])


def check(links, largest_deg):
    """Compare linkages with the independent program; return how many pass 0…90°."""
    passing = []
    for link, (low, high, dead_centres, reversals) in zip(
        links, oracle(links, largest_deg), strict=True
    ):
        limits = assembly_limits(link)
        nearest = np.concatenate([[MIDDLE - np.pi], limits, [MIDDLE + np.pi]])
        # The walk ends 1e-9 rad before a limit, where the loop of double precision closes no more.
        assert low == pytest.approx(nearest[nearest < MIDDLE][-1], abs=1e-6)
        assert high == pytest.approx(nearest[nearest > MIDDLE][0], abs=1e-6)
        for angles, by_differences in (
            (rod_dead_centres(link), dead_centres),
            (encoder_reversals(link), reversals),
        ):
            # Differences of 1e-6 rad have errors of 1e-10, times the conditioning of the extremum.
            # They see nothing that is nearer than some steps to a limit.
            seen, walked_by = (
                all_of[(np.abs(all_of - low) > 1e-5) & (np.abs(all_of - high) > 1e-5)]
                for all_of in (angles, by_differences)
            )
            np.testing.assert_allclose(seen, walked_by, rtol=0.0, atol=1e-5)
        assert inversions(link) == NAMES[tuple(turning_joints(lengths_of(link)))]
        if low < 0.0 and high > np.pi / 2.0:
            passing.append(link)
        else:
            assert_named_change_closes(link)
    if passing:
        check_angles(passing, step=round(10.0 * min(largest_deg, 1.0)))
    return len(passing)


def check_angles(passing, step):
    """Compare the angles between links at 0, 1, …, 90°; a step is in tenths of 1°."""
    loops = Loops.of(passing)
    theta = {450: loops.start()}
    for tenth in [*range(450 + step, 901, step), *range(450 - step, -1, -step)]:
        near = theta[tenth - step if tenth > 450 else tenth + step]
        theta[tenth], closed = loops.close(np.radians(0.1 * tenth), near)
        assert closed.all()
    for n, link in enumerate(passing):
        of = linkage_properties(link, RANGE)
        theta_2, theta_4 = np.array([theta[tenth][:, n] for tenth in range(0, 901, 10)]).T
        lines = {"transmission_angle_deg": theta_4 - theta_2,
                 "coupler_link_2_deg": RANGE - link.phi_rad - theta_2,
                 "coupler_link_4_deg": RANGE - link.phi_rad - theta_4}  # fmt: skip
        for name, between in lines.items():
            between = np.degrees(between) % 180.0
            angle = np.minimum(between, 180.0 - between)
            result = getattr(of, name)
            np.testing.assert_allclose(result.values, angle, rtol=0.0, atol=1e-7)
            assert result.least == pytest.approx(angle.min(), abs=1e-7)
            assert angle[round(result.at_deg)] == pytest.approx(angle.min(), abs=1e-7)


def assert_named_change_closes(link):
    """The links close over −2…91° at both ends of the named range of one length, or of both."""
    with pytest.raises(LinkageError) as error:
        linkage_properties(link)
    text = str(error.value)
    if found := re.search(r"; (a_[24]_m) must be (\S+) … (\S+) m$", text):
        changes = [{found[1]: float(found[2])}, {found[1]: float(found[3])}]
    else:
        equal = float(re.search(r"; choose a_2_m = a_4_m, at least (\S+) m$", text)[1])
        changes = [{"a_2_m": equal, "a_4_m": equal}]
    for change in changes:
        pose(link.changed(change), np.radians(np.linspace(-2.0, 91.0, 931)))


@pytest.mark.slow
def test_500_random_linkages_agree_with_loop_closure_by_root_finding():
    assert 50 < check(random_links(500, seed=1), largest_deg=0.2) < 450


@pytest.mark.parametrize("link", [G1, G3, G4], ids=["G1", "G3", "G4"])
def test_linkages_agree_with_loop_closure_by_root_finding(link):
    assert check([link], largest_deg=10.0) == 1


@pytest.mark.parametrize(
    "n", [*range(10, 14), *(pytest.param(n, marks=pytest.mark.slow) for n in range(14, 30))]
)
def test_a_random_linkage_agrees_with_loop_closure_by_root_finding(n):
    check(random_links(30, seed=2)[n : n + 1], largest_deg=10.0)


# --------------------------------------------------------------------------- known figures


@pytest.mark.parametrize(
    ("name", "margin_mm", "thigh", "shank", "dead_centre", "reversal", "transmission", "arm_mm"),
    [
        ("G1", 0.6000, "double crank", "double rocker", -11.730, -29.025, 25.03, 36.80),
        ("G2", 0.5000, "double rocker", "double crank", -16.269, -28.512, 25.01, 37.46),
        ("G3", 0.5000, "double crank", "double rocker", -14.128, None, 31.51, 37.66),
        ("G4", 1.3743, "double crank", "double rocker", -10.617, None, 8.48, 33.99),
    ],
)
def test_the_linkages_have_their_known_properties(
    name, margin_mm, thigh, shank, dead_centre, reversal, transmission, arm_mm
):
    of = linkage_properties(LINKAGES[name])
    # Half a unit of the last digit.
    assert of.grashof_margin_m / MM == pytest.approx(margin_mm, abs=5e-5)
    assert (of.thigh_as_ground, of.shank_as_ground) == (thigh, shank)
    assert of.assembly_limits_deg == ()
    assert of.rod_dead_centres_deg[0] == pytest.approx(dead_centre, abs=5e-4)
    assert len(of.rod_dead_centres_deg) == 2
    near = [angle for angle in of.encoder_reversals_deg if angle < 90.0]
    assert near == ([] if reversal is None else [pytest.approx(reversal, abs=5e-4)])
    assert of.branch_defects == ()
    assert of.transmission_angle_deg.least == pytest.approx(transmission, abs=5e-3)
    assert of.rod_arm_m.least / MM == pytest.approx(arm_mm, abs=5e-3)
    assert of.rod_arm_m.at_deg == 0.0
    assert of.mobility == MOBILITY == 1


def with_lengths(ground, a_2, a_3, a_4):
    return changed(G3, o_a_x_m=0.0, o_a_y_m=0.0, o_b_x_m=ground, o_b_y_m=0.0,
                   a_2_m=a_2, a_3_m=a_3, a_4_m=a_4)  # fmt: skip


@pytest.mark.parametrize(
    ("lengths", "names"),
    [
        ((0.02, 0.05, 0.04, 0.05), ("double crank", "double rocker")),
        ((0.05, 0.04, 0.02, 0.05), ("double rocker", "double crank")),
        ((0.04, 0.02, 0.05, 0.05), ("crank rocker", "crank rocker")),
        ((0.04, 0.05, 0.05, 0.02), ("crank rocker", "crank rocker")),
        ((0.04, 0.02, 0.05, 0.025), ("triple rocker", "triple rocker")),
        ((0.04, 0.02, 0.04, 0.02), ("change point", "change point")),
        ((0.04, 0.02, 0.04, 0.0200009), ("change point", "change point")),
        ((0.0, 0.02, 0.03, 0.02), ("hinge", "hinge")),
    ],
)
def test_inversions_have_their_names(lengths, names):
    assert inversions(with_lengths(*lengths)) == names


def test_a_hinge_moves_without_limits_and_its_triangle_keeps_its_angles():
    link = changed(
        G1, o_a_x_m=0.0, o_a_y_m=0.0, o_b_x_m=0.0, o_b_y_m=0.0, a_2_m=0.03, a_3_m=0.04, a_4_m=0.05
    )
    of = linkage_properties(link)
    assert (of.assembly_limits_deg, of.encoder_reversals_deg) == ((), ())
    # Angles of a triangle with sides 3, 4, 5. Rounding of asin near 1 is 1e-8 rad.
    triangle = np.degrees(np.arccos(3.0 / 5.0)), 90.0, np.degrees(np.arccos(4.0 / 5.0))
    for result, angle in zip(
        (of.transmission_angle_deg, of.coupler_link_2_deg, of.coupler_link_4_deg),
        triangle,
        strict=True,
    ):
        np.testing.assert_allclose(result.values, angle, atol=1e-5)
    # The rod of a hinge stands still where pins and axis lie on a line, twice in a turn.
    assert np.diff(of.rod_dead_centres_deg) == pytest.approx([180.0], abs=1e-9)


def test_what_stands_still_within_the_motion_is_a_branch_defect():
    motion = np.radians(np.linspace(-35.0, 0.0, 36))
    assert linkage_properties(G1, motion).branch_defects == (
        "the rod has a dead centre at knee angle -11.73 deg",
        "the encoder reverses at knee angle -29.03 deg",
    )


def test_a_parallelogram_has_a_change_point_within_the_motion():
    link = changed(with_lengths(0.04, 0.02, 0.04, 0.02), phi_rad=np.radians(30.05), branch=-1)
    of = linkage_properties(link)
    assert "links 2 and 4 are parallel at knee angle 30.05 deg" in of.branch_defects


def test_a_linkage_that_breaks_within_the_range_names_the_length_to_change():
    with pytest.raises(LinkageError) as error:
        linkage_properties(changed(G1, a_4_m=0.014))
    assert str(error.value).startswith("the linkage cannot be assembled at knee angle 0 deg: ")
    assert_named_change_closes(changed(G1, a_4_m=0.014))
    with pytest.raises(LinkageError, match=r"; choose a_2_m = a_4_m, at least 0.02\d+ m$"):
        linkage_properties(changed(G1, a_2_m=0.001, a_4_m=0.001))
    assert_named_change_closes(changed(G1, a_2_m=0.001, a_4_m=0.001))
