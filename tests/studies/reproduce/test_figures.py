import numpy as np
import pytest
from reproduce_cases import (
    ANGLES,
    GAINS,
    PHASES,
    TIME,
)
from scipy.interpolate import PchipInterpolator

from kneexo.studies.reproduce.figures import figures, motions


def test_the_view_shows_the_runs_of_fig_12(known):
    shown = motions(known)
    assert list(shown) == [
        "Fig. 12, sliding-mode control",
        "Fig. 12, PID as in the paper (P, 5 1/s)",
    ]
    for (plant, columns), name in zip(shown.values(), ("smc", "pid"), strict=True):
        tracked = known.fig12[name]
        assert plant is tracked.scenario.plant
        assert columns["knee_angle_rad"] is tracked.run["knee_angle_rad"]
        assert columns["time_s"] is tracked.run.time_s


def test_every_line_of_the_figures_is_that_of_its_run(known, curves, check_caption):
    drawn = figures(known)
    assert [name[:5] for name in drawn] == ["fig05", "fig09", "fig12", "fig13", "eq27_"]
    left, right, *_ = drawn["fig05_polynomial_fit"].axes
    for ax, x, y, fit, table in (
        (left, ANGLES, 148.0 - ANGLES, known.fit.p_mm_deg, known.fit.table.p_mm_deg),
        (right, 148.0 - ANGLES, ANGLES, known.fit.q_deg_mm, known.fit.table.q_deg_mm),
    ):
        lines = curves(ax)
        np.testing.assert_array_equal(lines["linkage (Eq. 1–9)"], (x[::30], y[::30]))
        np.testing.assert_array_equal(lines["quintic fit"], (x, np.polyval(fit, x)))
        np.testing.assert_array_equal(lines["Table 1"], (x, np.polyval(table, x)))
    rod, error = drawn["fig09_ideal_smc"].axes
    lines = curves(rod)
    assert lines["reference"][1] == pytest.approx([100.0, 110.0, 120.0, 130.0])
    assert lines["rod extension"][1] == pytest.approx([50.0, 100.0, 119.8, 129.99])
    for ax, sign in ((error, 1.0), (error.child_axes[0], -1.0)):
        x, y = ax.lines[0].get_data()
        assert x == pytest.approx(TIME)
        assert y == pytest.approx(sign * np.array([-50.0, -10.0, -0.2, -0.01]))
    panels = np.reshape(drawn["fig12_tracking"].axes, (3, 2))
    for n, (angle, wrong) in enumerate(panels):
        lines = curves(angle)
        assert lines["knee angle"][1] == pytest.approx((n + 1) * np.array([40, 40, 44, 40.0]))
        assert lines["reference"][1] == pytest.approx((n + 1) * np.array([40, 41, 42, 43.0]))
        assert wrong.lines[0].get_ydata() == pytest.approx((n + 1) * np.array([0, 1, -2, 3.0]))
        assert f"after one period {(n + 1) * 0.11:.3g}°" in wrong.get_title()
        assert ("PID" in angle.get_title()) == (n > 0)
    assert all(panels[0, 0].get_shared_x_axes().joined(panels[0, 0], ax) for ax in panels.flat)
    assert [ax.get_xlabel() for ax in panels.flat] == [""] * 4 + ["time (s)"] * 2
    exact, counts = drawn["eq27_at_2ms"].axes
    assert (exact.get_ylim(), counts.get_ylim()) == ((1e-2, 1e4), (-24.0, 16.0))
    assert [ax.get_ylabel() for ax in (exact, counts)] == [
        *("|load pressure| (Pa)", "tracking error (deg)")
    ]
    for ax in (exact, counts):
        assert (ax.get_xlabel(), ax.get_legend().get_title().get_text()) == (
            "time (s)",
            "k/Φ (1/s)",
        )
    for name, run in known.eq27_exact.items():
        x, y = curves(exact)[name]
        assert x == pytest.approx(run.time_s)
        assert y == pytest.approx(np.abs(run["load_pressure_pa"]))
    for name, factor in zip(known.eq27_differences, (10, 20), strict=True):
        assert curves(counts)[name][1] == pytest.approx(factor * np.array([0, 1, -2, 3.0]))
    for figure in drawn.values():
        check_caption(figure)
        assert all(ax.get_ylabel() for ax in figure.axes)


def test_fig_13_has_trials_means_our_crossing_and_the_papers(known, curves):
    gain, phase = figures(known)["fig13_frequency_response"].axes
    decibels = 20.0 * np.log10(GAINS)
    for ax, each, mean in (
        (gain, decibels, 20.0 * np.log10([0.95, 0.75, 0.55])),
        (phase, PHASES, np.array([-11.0, -22.0, -44.0])),
    ):
        for line, values in zip(ax.lines, each, strict=False):
            assert line.get_ydata() == pytest.approx(values)
        lines = curves(ax)
        assert lines["mean"][0] == pytest.approx([0.1, 0.2, 0.4])
        assert lines["mean"][1] == pytest.approx(mean)
        fine, values = lines["interpolation"]
        through = PchipInterpolator([0.1, 0.2, 0.4], 10.0 ** (mean / 20.0))(fine)
        if ax is gain:
            assert values == pytest.approx(20.0 * np.log10(through), abs=0.05)
        assert values[[0, -1]] == pytest.approx(mean[[0, -1]])
    vertical = {
        line.get_label(): line.get_xdata()[0]
        for line in gain.lines
        if len(set(line.get_xdata())) == 1
    }
    paper = [label for label in vertical if label.startswith("paper")]
    assert paper[0] in [text.get_text() for text in gain.get_legend().get_texts()]
    assert [vertical[label] for label in paper] == [0.21]
    assert "0.21 Hz" in paper[0]
    assert sorted(vertical.values()) == [0.21, 0.22]
