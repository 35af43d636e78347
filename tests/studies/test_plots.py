import math

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, strategies as st
from matplotlib.colors import LogNorm, Normalize

from kneexo.studies.plots import (
    cell_borders,
    ecdf,
    heat_map,
    ink,
    legend_below,
    plain_ticks,
    shades,
)


@given(st.lists(st.floats(1.1, 10.0), min_size=1, max_size=8), st.floats(1e-3, 1e3))
def test_borders_enclose_each_value_and_split_the_gaps_by_their_ratio(ratios, first):
    values = first * np.cumprod(ratios)
    borders = cell_borders(values)
    assert np.all(borders[:-1] < values)
    assert np.all(values < borders[1:])
    # An inner border is the geometric mean of its neighbours.
    assert borders[1:-1] == pytest.approx(np.sqrt(values[1:] * values[:-1]))


def test_cells_show_values_x_by_y_and_mask_what_is_not_finite():
    values = np.array([[1.0, np.inf, 3.0], [4.0, np.nan, 600.0]])
    _, ax = plt.subplots()
    norm = LogNorm(1.0, 10.0)
    heat_map(ax, [1.0, 2.0], [10.0, 20.0, 40.0], values, norm=norm, label="e (deg)", worse="high")
    mesh = ax.collections[0]
    # The borders lie half a ratio outside the first and the last value.
    assert ax.get_xlim() == pytest.approx((1.0 / 2.0**0.5, 2.0 * 2.0**0.5))
    assert ax.get_ylim() == pytest.approx((10.0 / 2.0**0.5, 40.0 * 2.0**0.5))
    shown = mesh.get_array()
    assert shown.shape == (3, 2)
    assert np.array_equal(shown.mask, ~np.isfinite(values.T))
    assert shown[2, 1] == 600.0
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.get_title(loc="right") == "e (deg)"
    assert mesh.colorbar.extend == "max"
    ticks = zip(mesh.colorbar.ax.get_yticks(), mesh.colorbar.ax.get_yticklabels(), strict=True)
    shown = [text.get_text() for tick, text in ticks if 1.0 <= tick <= 10.0]
    assert shown == ["1", "2", "5", "10"]


def test_a_map_without_any_value_is_hatched():
    figure, ax = plt.subplots()
    nothing = np.array([[np.nan]])
    heat_map(ax, [1.0], [1.0], nothing, norm=Normalize(0.0, 1.0), label="x", worse="low")
    assert ax.patch.get_hatch()
    figure.canvas.draw()
    assert ax.collections[0].colorbar.extend == "neither"


@pytest.mark.parametrize(("worse", "sign"), [("low", 1.0), ("high", -1.0)])
def test_darker_is_worse_and_its_text_is_white(worse, sign):
    figure, ax = plt.subplots()
    values = np.linspace(0.0, 1.0, 9)
    norm = Normalize(0.0, 1.0)
    colours = heat_map(ax, [1.0], values + 1.0, values[None, :], norm=norm, label="", worse=worse)
    assert ax.collections[0].get_cmap() == colours
    figure.canvas.draw()
    brightness = sign * (ax.collections[0].get_facecolors()[:, :3] @ [0.21, 0.72, 0.07])
    assert np.all(np.diff(brightness) > 0.0)
    ends = [ink(colours(norm(value))) for value in (0.0, 1.0)]
    assert ends == (["w", "k"] if worse == "low" else ["k", "w"])


def test_a_text_is_white_on_dark_colours_and_black_on_light_ones():
    assert [ink([grey] * 3 + [1.0]) for grey in (0.0, 0.4, 0.5, 1.0)] == ["w", "w", "k", "k"]


def test_a_larger_value_has_a_darker_curve():
    brightness = shades(6)[:, :3] @ [0.21, 0.72, 0.07]
    assert np.all(np.diff(brightness) < -0.02)


def test_ticks_are_plain_numbers_at_the_values_alone():
    figure, ax = plt.subplots()
    ax.set(xscale="log", xlim=(1.0, 100.0))
    plain_ticks(ax.xaxis, (5.0, 20.0, 80.0))
    figure.canvas.draw()
    assert [label.get_text() for label in ax.get_xticklabels()] == ["5", "20", "80"]
    assert ax.get_xticks(minor=True).size == 0


def test_ticks_that_would_overlap_are_left_out():
    _, ax = plt.subplots()
    ax.set(xscale="log", xlim=(300.0, 1400.0))
    plain_ticks(ax.xaxis, [330.0, 660.0, 690.0, 720.0, 1300.0])
    assert ax.get_xticks().tolist() == [330.0, 660.0, 1300.0]


def test_a_legend_below_the_figure_has_each_label_once():
    figure, axes = plt.subplots(1, 2, layout="constrained")
    for ax, names in zip(axes, ("ab", "bc"), strict=True):
        for name in names:
            ax.plot([0.0, 1.0], [0.0, 1.0], label=name)
    legend_below(figure, axes, 2, fontsize=8)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["a", "b", "c"]
    assert {text.get_fontsize() for text in legend.get_texts()} == {8}
    figure.canvas.draw()
    left = [text.get_window_extent().x0 for text in legend.get_texts()]
    assert left[0] == pytest.approx(left[1])  # two columns
    assert left[0] < left[2]


def test_a_distribution_counts_what_it_cannot_draw():
    _, ax = plt.subplots()
    ecdf(ax, [3.0, math.inf, 1.0, -math.inf], color="C0")
    x, y = ax.lines[0].get_data()
    assert list(x) == [1.0, 3.0]
    assert list(y) == [0.5, 0.75]
