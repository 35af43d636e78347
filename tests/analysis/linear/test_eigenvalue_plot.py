"""The z-plane: eigenvalues, lines of constant damping, and the inset near z = 1."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis.linear.eigenvalue_plot import plot_eigenvalues

SLOW = [0.98 + 0.02j, 0.98 - 0.02j, 0.82 + 0.07j, 0.82 - 0.07j]


def drawn(values):
    _, ax = plt.subplots(figsize=(5.5, 5.5), layout="constrained")
    plot_eigenvalues(ax, np.array(values, dtype=complex))
    ax.figure.canvas.draw()
    return ax


def test_each_eigenvalue_is_drawn_as_stable_or_unstable(curves):
    lines = curves(drawn([*SLOW, 0.0, 1.1, -0.5 + 1.0j]))
    assert [complex(*at) for at in zip(*lines["stable"], strict=True)] == [*SLOW, 0.0]
    assert [complex(*at) for at in zip(*lines["unstable"], strict=True)] == [1.1, -0.5 + 1.0j]


def test_labels_lie_on_their_lines_and_off_the_unit_circle():
    for text in drawn(SLOW).texts:
        z = complex(*text.get_position())
        s = np.log(z)  # of a pole at s, z = exp(s T)
        assert text.get_text() == f"ζ = {-s.real / abs(s):.1g}"
        assert abs(z) < 0.9


def test_an_inset_enlarges_what_is_near_one():
    ax = drawn([*SLOW, 0.0, 0.76 + 0.6j, 0.76 - 0.6j])
    (inset,) = ax.child_axes
    (x0, x1), (y0, y1) = inset.get_xlim(), inset.get_ylim()
    assert all(x0 < z.real < x1 and y0 < z.imag < y1 for z in SLOW)
    # Its scale is larger, and the same in both directions.
    for axes, least in ((ax, 0.0), (inset, 2.5)):
        box = axes.get_window_extent()
        scale = box.width / np.ptp(axes.get_xlim())
        assert scale == pytest.approx(box.height / np.ptp(axes.get_ylim()), rel=0.02)
        assert scale > least * ax.get_window_extent().width / np.ptp(ax.get_xlim())
    assert inset.get_title() == "near z = 1"
    shown = inset.transAxes.transform([[0.0, 0.0], [1.0, 1.0]])
    (left, bottom), (right, top) = ax.transData.inverted().transform(shown)
    assert not any(left < z.real < right and bottom < z.imag < top for z in (0.0, *SLOW))


@pytest.mark.parametrize("others", [[-0.4], [-0.5 + 0.3j, -0.5 - 0.3j]])
def test_an_inset_hides_no_eigenvalue(others):
    assert drawn([*SLOW, *others]).child_axes == []


def test_two_slow_eigenvalues_get_an_inset():
    assert len(drawn(SLOW[:2]).child_axes) == 1


def test_a_single_slow_eigenvalue_needs_no_inset():
    assert drawn([0.95, 0.2]).child_axes == []
