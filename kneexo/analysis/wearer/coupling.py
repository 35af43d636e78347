"""Coupled stability of knee and wearer, and the stable interval of a virtual stiffness.

Knee, cuff and leg are one sampled loop (`kneexo.analysis.linearize_loop`). The loop is stable if
all its eigenvalues λ for one sample have |λ| < 1. In all functions a constant torque carries the
weight of the shank, so that the loop rests at the given knee angle. An active leg takes the place
of a passive leg, which has the same linear equations. Stability holds for small motions, without
quantizers, slip and limits of the motor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from kneexo.analysis.linear.margins import soundness
from kneexo.analysis.linear.plant_linearization import MID_RANGE_DEG
from kneexo.analysis.linear.sampled_loop import SampledLoop, linearize_loop
from kneexo.analysis.wearer.impedance import output_impedance, posed, torque_controller
from kneexo.common.plotting import BLUE, GOLD, RED, axes_or_new, decimal_ticks
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError
from kneexo.parameters import LegParameters, Scenario
from kneexo.parameters.criteria import SOUND_DISK_MARGIN
from kneexo.parameters.labels import labels
from kneexo.parameters.paths import changed, value_at
from kneexo.parameters.wearer.wearer import STIFFNESS_FREQUENCY_HZ, WEARERS

_STIFFNESS = "controller.stiffness_n_m_per_rad"
_STIFFNESSES = np.append(0.0, np.geomspace(1.0, 1e6, 21))
"""Virtual stiffnesses in N·m/rad at which stability is computed: 0, and 1 … 1e6 by factors of 2.

The range and the factor are a choice. An interval of stability between two neighbouring values is
not found. Above 1e6 N·m/rad stability is not computed.
"""

_PROBE_STIFFNESS = 1e3
"""Virtual stiffness in N·m/rad of the second of the two loops that give all loops."""

_SAME_NAME_IN_SEVERAL_PARTS = [
    f"{part}.{name}"
    for part in ("wearer", "wearer.cuff", "controller")
    for name in ("stiffness_n_m_per_rad", "damping_n_m_s_per_rad")
]
"""Paths of parameters with equal names. Among these paths, `labels` gives a label with the part."""


def coupled_loop(scenario: Scenario, knee_angle_deg: float = MID_RANGE_DEG) -> SampledLoop:
    """Return the linear loop of knee and wearer of a scenario, at rest at a knee angle in deg.

    Raises `LinearizationError` if the loop does not rest at the angle.
    """
    # The motion of a prescribed leg does not depend on the exoskeleton. The leg rests here.
    held = value_at(scenario, "wearer.motion") == "prescribed"
    scenario = posed(scenario, knee_angle_deg, "prescribed" if held else "active")
    return linearize_loop(scenario, knee_angle_deg=knee_angle_deg)


def stable_interval(
    scenario: Scenario,
    path: str,
    values: ArrayLike,
    *,
    knee_angle_deg: float = MID_RANGE_DEG,
) -> tuple[float, float]:
    """Return the ends of the interval of a parameter in which the loop is stable.

    Stability is computed at each of ``values`` and at the value that the scenario has. Between a
    stable and an unstable neighbour a root search finds the end, where max|λ| = 1, with a relative
    error of 1e-6. If the loop is stable at the first or last value, this value is an end of the
    interval. If there are several intervals, the result is the interval that contains the
    scenario's value, or else the interval nearest to the scenario's value. If the loop is stable at
    no value, both ends are nan.

    Parameters
    ----------
    scenario
        The scenario with all other values.
    path
        Dotted path of the parameter, such as ``"controller.stiffness_n_m_per_rad"``.
    values
        Values of the parameter to try, (n,), in its unit.
    knee_angle_deg
        Knee angle in deg at which the loop rests and is linearized.

    Raises
    ------
    ParameterError
        A value is out of the range of the parameter.
    LinearizationError
        The loop does not rest at the angle with one of the values.
    """

    given = value_at(scenario, path)
    scenario = changed(scenario, {path: given})  # refuses an unknown path

    def growth(value: float) -> float:
        return _growth(coupled_loop(changed(scenario, {path: value}), knee_angle_deg).monodromy)

    return _interval(growth, values, given)


def _growth(monodromy: Array) -> float:
    """Return max|λ| − 1, negative for a stable loop, from the matrix of the loop for one sample."""
    return float(np.abs(np.linalg.eigvals(monodromy)).max()) - 1.0


def _interval(
    growth: Callable[[float], float], values: ArrayLike, given: float
) -> tuple[float, float]:
    """Return the ends of the interval of a parameter in which the loop is stable.

    ``growth`` is a function of the value of the parameter that is negative where the loop is
    stable. `stable_interval` describes ``values`` and the result. ``given`` is the value of the
    scenario.
    """
    grid = np.union1d(np.asarray(values, dtype=float), given)
    stable = np.array([growth(value) < 0.0 for value in grid])
    if not stable.any():
        return math.nan, math.nan
    start = int(np.argmin(np.where(stable, np.abs(grid - given), np.inf)))
    unstable = np.flatnonzero(~stable)
    below, above = unstable[unstable < start], unstable[unstable > start]
    return (
        _border(growth, *grid[[below[-1], below[-1] + 1]]) if below.size else float(grid[0]),
        _border(growth, *grid[[above[0] - 1, above[0]]]) if above.size else float(grid[-1]),
    )


def _border(growth: Callable[[float], float], low: float, high: float) -> float:
    """Return the value between ``low`` and ``high`` at which the growth changes its sign."""
    return float(scipy.optimize.brentq(growth, low, high, rtol=1e-6))


@dataclass(frozen=True, repr=False)
class StiffnessInterval(Result):
    """Interval of the virtual stiffness in N·m/rad in which knee and wearer are stable together.

    Both ends are nan if no stiffness is stable. ``high_n_m_per_rad`` is 1e6 if the loop is stable
    at 1e6 N·m/rad. Without virtual damping a large stiffness controls the position, and the lags of
    motor and hold limit the stiffness. A low end above zero means that the loop is unstable at a
    stiffness just below. `stable_interval` says which of several intervals counts.

    The interval is valid for small motions without encoder counts. A count of the encoder times a
    large stiffness is a large torque, for example 57 N·m for 0.088° times 37 kN·m/rad.
    """

    low_n_m_per_rad: float
    high_n_m_per_rad: float
    knee_angle_deg: float
    scenario: Scenario

    @cached_property
    def felt_n_m_per_rad(self) -> float:
        """Dynamic stiffness |jωZ| in N·m/rad of zero torque, at the leg's side of the cuff.

        The frequency is `kneexo.parameters.wearer.wearer.STIFFNESS_FREQUENCY_HZ`. A wearer cannot
        feel a virtual spring that is much softer than this stiffness. Raises `ParameterError`
        without a wearer.
        """
        free = changed(self.scenario, {"controller.mode": "zero_torque"})
        f = STIFFNESS_FREQUENCY_HZ
        z = output_impedance(free, [f], knee_angle_deg=self.knee_angle_deg)
        return float(z.magnitude[0]) * 2.0 * math.pi * f


def stiffness_interval(
    scenario: Scenario, *, knee_angle_deg: float = MID_RANGE_DEG
) -> StiffnessInterval:
    """Return the stable interval of the virtual stiffness K_v, with the other gains as they are.

    The law is τ_d = −K_v (θ − θ_ref) − B_v dθ/dt with a constant θ_ref. In the mode
    ``assist_as_needed``, which has no damping, B_v is zero. `stable_interval` says which
    of several intervals counts.

    Raises `ParameterError` if the controller does not control the torque, and `LinearizationError`
    if the loop does not rest at ``knee_angle_deg``.
    """
    law = torque_controller(scenario, "stiffness_interval")
    damping = 0.0 if law.mode == "assist_as_needed" else law.damping_n_m_s_per_rad
    spring = {"controller.mode": "impedance", "controller.damping_n_m_s_per_rad": damping}
    free, stiff = (
        coupled_loop(changed(scenario, spring | {_STIFFNESS: value}), knee_angle_deg).monodromy
        for value in (0.0, _PROBE_STIFFNESS)
    )

    def growth(value: float) -> float:
        # At a fixed knee angle the matrix is an affine function of the stiffness. So two loops give
        # the matrix for each stiffness.
        return _growth(free + value / _PROBE_STIFFNESS * (stiff - free))

    ends = _interval(growth, _STIFFNESSES, law.stiffness_n_m_per_rad)
    return StiffnessInterval(*ends, knee_angle_deg, scenario)


_MARGINS = ("gain_margin", "lower_gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")


@dataclass(frozen=True, repr=False)
class CoupledStability(Result):
    """Stability and margins of a loop over two quantities, such as wearer and knee angle.

    ``rows`` (n,) and ``columns`` (m,) are the values of the two quantities. The arrays have the
    shape (n, m). ``largest_eigenvalue`` is max|λ|. The margins belong to the loop at the motor
    speed command, as in `kneexo.analysis.Margins`, and are nan where the loop is unstable.
    ``border`` has pairs of row and column at which max|λ| = 1 to 1e-6. There is one pair between
    two neighbouring columns if the loop is stable at one of them only.
    """

    row_label: str
    column_label: str
    rows: tuple[Any, ...]
    columns: tuple[float, ...]
    largest_eigenvalue: Array
    gain_margin: Array
    lower_gain_margin: Array
    phase_margin_deg: Array
    delay_margin_s: Array
    disk_margin: Array
    border: tuple[tuple[Any, float], ...]

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` with a line for each pair of row and column.

        Raises `PackageError` without pandas.
        """
        rows, columns = zip(*product(self.rows, self.columns), strict=True)
        names = ("largest_eigenvalue", *_MARGINS)
        measures = {name: getattr(self, name).ravel() for name in names}
        return data_frame({self.row_label: rows, self.column_label: columns} | measures)

    def plot(self, ax: Any = None) -> Any:
        """Plot a mark for each pair, and the border of stability. Return the Matplotlib axes.

        The x axis has the quantity of the rows, the y axis that of the columns.
        """
        caption = (
            "Stability of knee and wearer. A loop is sound if its disk margin is at least "
            f"{SOUND_DISK_MARGIN:g}. Bars are on the border of stability."
        )
        ax = axes_or_new(ax, caption=caption, figsize=(7, 5))
        pairs = np.array(list(product(self.rows, self.columns)), dtype=object)
        words = np.array([soundness(margin) for margin in self.disk_margin.ravel()])
        for word, style in _MARKS.items():
            ax.plot(*pairs[words == word].T, ls="none", label=word, **style)
        if self.border:
            ax.plot(*zip(*self.border, strict=True), "k_", ms=16, mew=2, label="border")
        for name, values in (("x", self.rows), ("y", self.columns)):
            if not isinstance(values[0], str) and max(values) >= 10.0 * min(values) > 0.0:
                ax.set(**{f"{name}scale": "log"})
                decimal_ticks(getattr(ax, f"{name}axis"))
        ax.set(xlabel=self.row_label, ylabel=self.column_label)
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
        return ax


_MARKS: dict[str, dict[str, Any]] = {
    "sound": {"marker": "o", "color": BLUE},
    "small margin": {"marker": "o", "color": GOLD, "mfc": "w"},
    "unstable": {"marker": "x", "color": RED},
}


def coupled_stability(
    scenario: Scenario,
    wearers: Mapping[str, LegParameters] = WEARERS,
    *,
    knee_angles_deg: Sequence[float] = (10.0, 45.0, 85.0),
) -> CoupledStability:
    """Return stability and margins of a scenario's loop with each wearer, at each knee angle.

    Parameters
    ----------
    scenario
        The scenario, whose wearer is replaced. The cuff of its wearer, if it has one, is kept.
    wearers
        The legs by name, by default `WEARERS`.
    knee_angles_deg
        Knee angles in deg at which the loop rests and is linearized.

    Raises
    ------
    ParameterError
        There are no wearers or no angles.
    LinearizationError
        The loop does not rest at an angle.
    """
    cuff = value_at(scenario, "wearer.cuff")
    legs = {
        name: leg if cuff is None else leg.model_copy(update={"cuff": cuff})
        for name, leg in wearers.items()
    }

    def loop_of(name: str, angle_deg: float) -> SampledLoop:
        return coupled_loop(changed(scenario, {"wearer": legs[name]}), angle_deg)

    return _survey({"wearer": tuple(wearers), "knee angle (deg)": knee_angles_deg}, loop_of)


def stability_map(
    scenario: Scenario,
    values: Mapping[str, Sequence[float]],
    *,
    knee_angle_deg: float = MID_RANGE_DEG,
) -> CoupledStability:
    """Return a map of stability and margins of a scenario's loop over two of its parameters.

    Parameters
    ----------
    scenario
        The scenario with all other values.
    values
        Two entries, from the dotted path of a parameter to its values in ascending order. The
        values of the first parameter are the rows of the map, those of the second the columns.
    knee_angle_deg
        Knee angle in deg at which the loop rests and is linearized.

    Raises
    ------
    ParameterError
        ``values`` has not two entries, or a value is out of range.
    LinearizationError
        The loop does not rest at the angle.
    """
    if len(values) != 2:
        raise ParameterError(f"values: has {len(values)} parameters; must have two")
    row_path, column_path = values

    def loop_of(row: float, column: float) -> SampledLoop:
        return coupled_loop(changed(scenario, {row_path: row, column_path: column}), knee_angle_deg)

    names = labels([*values, *_SAME_NAME_IN_SEVERAL_PARTS])
    return _survey({names[path]: values[path] for path in values}, loop_of)


def _survey(
    axes: Mapping[str, Sequence[Any]], loop_of: Callable[[Any, float], SampledLoop]
) -> CoupledStability:
    """Return the stability of the loops at all pairs of a row and a column.

    ``axes`` has two entries, from the label of an axis to its values: rows first, then columns.
    ``loop_of(row, column)`` returns the loop at a pair.
    Raises `ParameterError` for an axis without values.
    """
    for label, values in axes.items():
        if not len(values):
            raise ParameterError(f"{label}: has no values; give at least one")
    (row_label, rows), (column_label, columns) = ((name, tuple(axes[name])) for name in axes)
    loops = [[loop_of(row, column) for column in columns] for row in rows]

    def growth(row: Any, column: float) -> float:
        return _growth(loop_of(row, column).monodromy)

    stable = np.array([[loop.stable for loop in row] for row in loops])
    margins = [[loop.margins() if loop.stable else None for loop in row] for row in loops]
    border = [
        (rows[i], _border(partial(growth, rows[i]), *columns[j : j + 2]))
        for i, j in np.argwhere(stable[:, 1:] != stable[:, :-1])
    ]
    measures = {
        name: np.array([[getattr(m, name, np.nan) for m in row] for row in margins])
        for name in _MARGINS
    }
    largest = np.array([[_growth(loop.monodromy) + 1.0 for loop in row] for row in loops])
    return CoupledStability(
        row_label, column_label, rows, columns, largest, **measures, border=tuple(border)
    )
