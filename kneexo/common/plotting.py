"""Colours, captions, axes and ticks that all figures share.

The caption of a figure is its Matplotlib label, one or more sentences that a page shows below the
figure: ``figure.get_label()``.
"""

from __future__ import annotations

import math
from typing import Any

# Matplotlib's first colours coincide for people with deuteranopia.
BLUE = "#2166AC"
"""Colour of the first curve, such as the knee angle."""
GOLD = "#B8860B"
"""Colour of the second curve."""
TEAL = "#1B9E77"
"""Colour of the third curve, such as the motor's command."""
PURPLE = "#AA3377"
"""Colour of the fourth curve, such as the tracking error."""
BROWN = "#5A3A22"
"""Colour of the fifth curve."""
RED = "#CC3311"
"""Colour of limits, failures and unstable loops, and of nothing else."""
SERIES = (BLUE, GOLD, TEAL, PURPLE, BROWN)
"""Colours of curves. They stay apart, also with `RED`, for people with any colour blindness."""


def axes_or_new(ax: Any, *shape: int, caption: str = "", **options: Any) -> Any:
    """Return ``ax``, or the Matplotlib axes of a new figure with ``caption`` if ``ax`` is None.

    ``shape`` and ``options`` are arguments of ``matplotlib.pyplot.subplots``.
    """
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(*shape, layout="constrained", **options)
    figure.set_label(caption)
    return axes


def label_bode(axes: Any, magnitude: str) -> None:
    """Label the two Matplotlib axes of a Bode plot, and draw their grids.

    ``magnitude`` is the label of the upper axes. The lower axes show the phase in deg over the
    frequency in Hz on a logarithmic axis.
    """
    axes[0].set(ylabel=magnitude)
    axes[1].set(xlabel="frequency (Hz)", ylabel="phase (deg)")
    phase_ticks(axes[1].yaxis)
    decimal_ticks(axes[1].xaxis)
    for axis in axes:
        axis.grid(alpha=0.3)


def phase_ticks(axis: Any) -> None:
    """Put the ticks of a phase axis in deg at multiples of 45°, 90° or 180°, at most nine.

    The limits of the axis at the time of the call decide between the three.
    """
    from matplotlib.ticker import MultipleLocator

    low, high = sorted(axis.get_view_interval())
    step = next((s for s in (45.0, 90.0) if (high - low) / s <= 8.0), 180.0)
    axis.set_major_locator(MultipleLocator(step))


def decimal_ticks(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers.

    The range of the axis at the time of the call decides which positions in each decade have a
    label. Below 0.8 decades these are 1, 1.5, 2, 3, 5 and 7. Below 1.5 decades these are 1, 2 and
    5, below 3 decades 1 and 3, and otherwise 1.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = sorted(axis.get_view_interval())
    decades = math.log10(high / low) if low > 0.0 else 1.0
    positions = {
        0.8: (1.0, 1.5, 2.0, 3.0, 5.0, 7.0),
        1.5: (1.0, 2.0, 5.0),
        3.0: (1.0, 3.0),
        math.inf: (1.0,),
    }
    subs = next(subs for most, subs in positions.items() if decades < most)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
