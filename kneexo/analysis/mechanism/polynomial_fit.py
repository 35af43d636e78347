"""Polynomial fit of the linkage (Lee et al. 2020, Fig. 5 and Table 1, Eq. 10, 11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kneexo.common.plotting import BLUE, GOLD, axes_or_new
from kneexo.common.result import Array, Result, data_frame
from kneexo.geometry.rod_polynomial import SAMPLES, quintic, rod_points
from kneexo.parameters import G1, LinkageParameters, RodPolynomialParameters

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, repr=False)
class PolynomialFit(Result):
    """Quintic polynomials x(θ_p) and θ_p(x) fitted to a linkage, and their errors, in mm and deg.

    ``angle_deg`` (knee angle θ_p) and ``extension_mm`` (rod extension x) are points of the linkage,
    each (n,). ``p_mm_deg`` and ``q_deg_mm`` (6,) are the fitted coefficients of x(θ_p) and θ_p(x),
    highest power first. ``p_error_mm`` and ``q_error_deg`` (n,) are the values of the linkage minus
    the fitted polynomial. ``table_p_error_mm`` and ``table_q_error_deg`` (n,)
    are the values of the linkage minus the polynomial of Table 1.
    """

    table: RodPolynomialParameters
    angle_deg: Array
    extension_mm: Array
    p_mm_deg: Array
    q_deg_mm: Array
    p_error_mm: Array
    q_error_deg: Array
    table_p_error_mm: Array
    table_q_error_deg: Array

    @property
    def p_sse_mm2(self) -> float:
        """Sum of the squares of ``p_error_mm`` in mm²."""
        return float(np.sum(self.p_error_mm**2))

    @property
    def q_sse_deg2(self) -> float:
        """Sum of the squares of ``q_error_deg`` in deg²."""
        return float(np.sum(self.q_error_deg**2))

    @property
    def degrees_of_freedom(self) -> int:
        """Number of points minus six coefficients. In Fig. 5, RMSE = √(SSE/degrees of freedom)."""
        return self.angle_deg.size - len(self.p_mm_deg)

    def to_dataframe(self) -> Any:
        """Return extension and errors as a `pandas.DataFrame` with the index ``angle_deg``.

        Raises `PackageError` without pandas.
        """
        names = ["angle_deg", "extension_mm", "p_error_mm", "q_error_deg"]
        names += ["table_p_error_mm", "table_q_error_deg"]
        return data_frame({name: getattr(self, name) for name in names}, "angle_deg")

    def plot(self, ax: Any = None) -> Any:
        """Plot linkage, fit and Table 1 for x(θ_p) and θ_p(x), as in Fig. 5, and their residuals.

        Returns four axes (2, 2). The upper row has the maps, the lower row the linkage minus each
        polynomial. ``ax`` has four Matplotlib axes. If it is None, a new figure is made.
        """
        caption = (
            "Rod extension over knee angle (a) and its inverse (b). The three curves coincide. "
            "The lower panels show the linkage minus each polynomial."
        )
        ax = axes_or_new(ax, 2, 2, caption=caption, sharex="col", figsize=(8.4, 5.6))
        table = self.table
        angle, rod = self.angle_deg, self.extension_mm
        self._plot_map(ax[0, 0], angle, rod, self.p_mm_deg, table.p_mm_deg)
        self._plot_map(ax[0, 1], rod, angle, self.q_deg_mm, table.q_deg_mm)
        self._plot_errors(ax[1, 0], angle, self.p_error_mm, self.table_p_error_mm)
        self._plot_errors(ax[1, 1], rod, self.q_error_deg, self.table_q_error_deg)
        ax[0, 0].set(ylabel="rod extension $x$ (mm)", title="(a) extension of the rod")
        ax[0, 1].set(ylabel=r"knee angle $\theta_p$ (deg)", title="(b) the inverse")
        ax[1, 0].set(xlabel=r"knee angle $\theta_p$ (deg)", ylabel="residual of $x$ (mm)")
        ax[1, 1].set(xlabel="rod extension $x$ (mm)", ylabel=r"residual of $\theta_p$ (deg)")
        return ax

    @staticmethod
    def _plot_map(ax: Axes, argument: Array, value: Array, fit: Any, table: Any) -> None:
        # Few points, so that the circles do not cover the curves.
        ax.plot(argument[::30], value[::30], "ko", ms=3.5, mfc="none", label="linkage (Eq. 1–9)")
        ax.plot(argument, np.polyval(fit, argument), BLUE, lw=1.2, label="quintic fit")
        ax.plot(argument, np.polyval(table, argument), GOLD, ls="--", lw=1.2, label="Table 1")
        ax.legend()

    @staticmethod
    def _plot_errors(ax: Axes, argument: Array, fit: Array, table: Array) -> None:
        ax.plot(argument, fit, BLUE, lw=1.2, label="quintic fit")
        ax.plot(argument, table, GOLD, ls="--", lw=1.2, label="Table 1")
        ax.axhline(0.0, color="0.7", lw=0.8, zorder=0)


def fit_polynomials(
    link: LinkageParameters = G1,
    table: RodPolynomialParameters = RodPolynomialParameters(),
    *,
    start_deg: float = 0.0,
    samples: int = SAMPLES,
) -> PolynomialFit:
    """Fit the quintics of Eq. 10 and 11 to a linkage, and compute the errors of given quintics.

    Parameters
    ----------
    link
        The linkage, by default G1.
    table
        Quintics whose errors are computed too, by default the quintics of Table 1 of the paper.
    start_deg
        Smallest knee angle of the fit in deg. The largest knee angle is 90°.
    samples
        Number of points of the fit, at equal distances in knee angle.

    Raises
    ------
    LinkageError
        The linkage cannot be assembled.
    """
    angle, extension = rod_points(link, start_deg=start_deg, samples=samples)
    p, q = quintic(angle, extension), quintic(extension, angle)
    return PolynomialFit(
        table=table,
        angle_deg=angle,
        extension_mm=extension,
        p_mm_deg=p,
        q_deg_mm=q,
        p_error_mm=extension - np.polyval(p, angle),
        q_error_deg=angle - np.polyval(q, extension),
        table_p_error_mm=extension - np.polyval(table.p_mm_deg, angle),
        table_q_error_deg=angle - np.polyval(table.q_deg_mm, extension),
    )
