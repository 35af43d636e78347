"""Colours that all people can tell apart, captions, and ticks."""

from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from kneexo.common.plotting import RED, SERIES, axes_or_new, decimal_ticks, label_bode, phase_ticks

# Linear RGB as seen with each kind of colour blindness (Machado et al. 2009, severity 1).
VISION = {
    "full": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


def linear_rgb(colour):
    share = np.array(to_rgb(colour))
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def oklab(linear):
    """Lightness and two colour axes, in which equal distances look equal (Ottosson 2020)."""
    cones = np.cbrt(
        np.array(
            [
                [0.4122214708, 0.5363325363, 0.0514459929],
                [0.2119034982, 0.6806995451, 0.1073969566],
                [0.0883024619, 0.2817188376, 0.6299787005],
            ]
        )
        @ linear
    )
    return (
        np.array(
            [
                [0.2104542553, 0.7936177850, -0.0040720468],
                [1.9779984951, -2.4285922050, 0.4505937099],
                [0.0259040371, 0.7827717662, -0.8086757660],
            ]
        )
        @ cones
    )


@pytest.mark.parametrize("vision", VISION.values(), ids=VISION)
def test_colours_stay_apart_with_every_colour_blindness(vision):
    seen = [oklab(np.clip(vision @ linear_rgb(c), 0.0, 1.0)) for c in (*SERIES, RED)]
    # A just noticeable difference is 0.02. Matplotlib's first four colours have 0.007.
    assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > 0.08


@pytest.mark.parametrize("colour", [*SERIES, RED])
def test_a_curve_has_the_contrast_that_wcag_requires_of_graphics(colour):
    luminance = linear_rgb(colour) @ [0.2126, 0.7152, 0.0722]
    assert 1.05 / (luminance + 0.05) >= 3.0


def test_new_axes_have_a_caption_and_given_axes_stay_as_they_are():
    axes = axes_or_new(None, 2, 1, caption="Two axes.", figsize=(3.0, 4.0))
    figure = axes[0].figure
    assert len(axes) == 2
    assert figure.get_label() == "Two axes."
    assert figure.get_size_inches() == pytest.approx([3.0, 4.0])
    assert axes_or_new(axes[1], caption="Another caption.") is axes[1]
    assert figure.get_label() == "Two axes."


@pytest.mark.parametrize(
    ("limits", "step"),
    [((-440.0, -80.0), 45.0), ((-441.0, -80.0), 90.0), ((0.0, 721.0), 180.0), ((10, -20), 45.0)],
)
def test_ticks_of_a_phase_are_multiples_of_45_degrees(limits, step):
    _, ax = plt.subplots()
    ax.set_ylim(limits)
    phase_ticks(ax.yaxis)
    low, high = sorted(limits)
    ticks = [t for t in ax.get_yticks() if low <= t <= high]
    first = step * np.ceil(low / step)
    assert ticks == pytest.approx(np.arange(first, high + 1e-9, step))


@pytest.mark.parametrize(
    ("limits", "ticks"),
    [
        ((0.0051, 0.0199), ["0.007", "0.01", "0.015"]),
        ((0.9, 5.5), ["1", "1.5", "2", "3", "5"]),
        ((0.9, 11.0), ["1", "2", "5", "10"]),
        ((0.09, 11.0), ["0.1", "0.3", "1", "3", "10"]),
        ((0.009, 110.0), ["0.01", "0.1", "1", "10", "100"]),
    ],
)
def test_decimal_ticks_suit_the_decades(limits, ticks):
    figure, ax = plt.subplots()
    ax.set(xscale="log", xlim=limits)
    decimal_ticks(ax.xaxis)
    low, high = limits
    shown = [t for t in ax.get_xticks() if low <= t <= high]
    assert [f"{t:g}" for t in shown] == ticks
    plt.close(figure)


def test_bode_axes_have_labels_grid_and_plain_ticks():
    figure, axes = plt.subplots(2, 1, sharex=True)
    axes[0].loglog([0.1, 100.0], [1.0, 2.0])
    axes[1].semilogx([0.1, 100.0], [-180.0, 90.0])
    label_bode(axes, "gain (dB)")
    figure.canvas.draw()
    assert [ax.get_ylabel() for ax in axes] == ["gain (dB)", "phase (deg)"]
    assert [ax.get_xlabel() for ax in axes] == ["", "frequency (Hz)"]
    assert "0.1" in [label.get_text() for label in axes[1].get_xticklabels()]
    assert {-90.0, 45.0} <= set(axes[1].get_yticks())
    assert all(ax.xaxis.get_gridlines()[0].get_visible() for ax in axes)
    plt.close(figure)
