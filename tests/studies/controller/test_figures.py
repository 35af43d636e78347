import math

import numpy as np
import pytest
from controller_cases import (
    GRID,
)

from kneexo.studies.controller.figures import figures
from kneexo.studies.controller.result import (
    ideal_settling_time_s,
)
from kneexo.studies.plots import colour_map


@pytest.mark.slow
def test_every_figure_can_be_drawn(small):
    for figure in figures(small[0]).values():
        figure.canvas.draw()


def test_the_maps_have_their_axes_where_the_labels_say(by_hand, check_heat_map, check_caption):
    drawn = figures(by_hand)
    for name, figure in drawn.items():
        check_caption(figure)
        if name != "study_claims":
            entries = [text.get_text() for text in figure.legends[0].get_texts()]
            assert {"no result", "linearly unstable", "default"} >= set(entries[:2])
            assert len(set(entries)) == len(entries)
    beta = math.sqrt(1.8 / 1.4)
    panels = (
        ("study_lambda_slope", "λ (1/s)", "k/Φ (1/s)"),
        ("study_phi_eta", "Φ (m/s²)", "η (m/s³)"),
    )
    names = {
        "study_lambda_slope": (
            *("max_error_deg", "mean_command_change_rpm", "settling_s", "disk_margin"),
        ),
        "study_phi_eta": (
            *("max_error_deg", "mean_command_change_rpm", "saturated_share", "disk_margin"),
        ),
    }
    rising = beta * 2.8e5 / np.array(GRID.phis_m_s2[::-1])
    for title, across, up in panels:
        axes = drawn[title].axes
        assert axes[2].get_xlabel() == across
        assert axes[0].get_ylabel() == up
        for ax, name in zip(axes[:4], names[title], strict=True):
            values = np.where(np.isinf(by_hand.values[name]), np.nan, by_hand.values[name])
            values = values * (100.0 if "(%)" in ax.get_title(loc="right") else 1.0)
            assert ("(%)" in ax.get_title(loc="right")) == (name == "saturated_share")
            # Darker is worse, a small margin as well as a large error.
            assert ax.collections[0].get_cmap() == colour_map("low" if "margin" in name else "high")
            if title == "study_lambda_slope":  # at the default η; the smallest Φ is on top
                check_heat_map(ax, GRID.lambdas_per_s, rising, values[:, ::-1, 1])
                stable = by_hand.values["stable"][:, ::-1, 1]
                x, y, default = GRID.lambdas_per_s, rising, (20.0, rising[2])
            else:  # at the default λ
                check_heat_map(ax, GRID.phis_m_s2, GRID.etas_m_s3, values[1])
                stable = by_hand.values["stable"][1]
                x, y, default = GRID.phis_m_s2, GRID.etas_m_s3, (3.2, 2.8e5)
            crosses, star = ax.lines[:2]
            unstable = sorted((x[i], y[j]) for i, j in np.argwhere(stable == 0.0))
            marked = sorted(zip(*crosses.get_data(), strict=True))
            assert np.array(marked) == pytest.approx(np.array(unstable))
            assert np.ravel(star.get_data()) == pytest.approx(default)
            if title == "study_phi_eta":  # dashed: where k/Φ = βη/Φ is a power of ten
                low = ax.get_xlim()[0], ax.get_ylim()[0]
                for line, text, power in zip(ax.lines[2:], ax.texts, (4, 5, 6), strict=True):
                    phis, etas = (np.asarray(values) for values in line.get_data())
                    assert beta * etas / phis == pytest.approx([10.0**power] * 2)
                    at = text.get_position()
                    assert beta * at[1] / at[0] == pytest.approx(10.0**power)
                    # Beside the left or above the lower edge, whichever the line meets.
                    away = at[0] / low[0] / 1.1, at[1] / low[1] / 1.7
                    assert min(away) == pytest.approx(1.0)
                    assert text.get_text() == f"10$^{power}$"
    _, error, margin, *_ = drawn["study_limit_cycle"].axes
    for ax, name in ((error, "max_error_deg"), (margin, "disk_margin")):
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("T_f (ms)", "k/Φ (1/s)")
        check_heat_map(ax, [10.0, 20.0], GRID.map_slopes_per_s, by_hand.map_values[name])
        crosses, star, circle = ax.lines
        assert np.ravel(crosses.get_data()) == pytest.approx([20.0, 1e5])
        assert np.ravel(star.get_data()) == pytest.approx([20.0, beta * 2.8e5 / 3.2])
        at = [1e3 * GRID.limit_cycle_time_constant_s, GRID.limit_cycle_slope_per_s]
        assert np.ravel(circle.get_data()) == pytest.approx(at)


def test_the_lines_of_the_claims_are_those_of_the_grid(by_hand, curves):
    drawn = figures(by_hand)
    faster, chattering, adherent, collapse = drawn["study_claims"].axes
    values, beta = by_hand.values, math.sqrt(1.8 / 1.4)
    lines = curves(faster)
    for label, name in (
        (f"step of {GRID.step_deg:g}°", "settling_s"),
        (f"step of {GRID.large_step_deg:g}°", "large_settling_s"),
    ):
        assert lines[label][0] == pytest.approx(GRID.lambdas_per_s)
        assert lines[label][1] == pytest.approx(values[name][:, 2, 1])
    assert lines["s = 0 alone"][1] == pytest.approx(
        [ideal_settling_time_s(x, 0.2 / GRID.step_deg) for x in GRID.lambdas_per_s]
    )
    for ax, labels, x, of in (
        (
            chattering,
            GRID.lambdas_per_s,
            GRID.phis_m_s2,
            lambda n: values["mean_command_change_rpm"][n, :, 1],
        ),
        (adherent, GRID.phis_m_s2, GRID.etas_m_s3, lambda n: values["max_error_deg"][1, n]),
    ):
        for label, (xs, ys) in curves(ax).items():
            assert xs == pytest.approx(x)
            assert ys == pytest.approx(of(labels.index(float(label))))
    for n, eta in enumerate(GRID.etas_m_s3):
        xs, ys = curves(collapse)[f"{eta / 1e3:g}"]
        assert xs == pytest.approx(beta * eta / np.array(GRID.phis_m_s2))
        assert ys == pytest.approx(values["max_error_deg"][1, :, n])
    spans = (  # with room for the legend above the highest value
        (faster, "λ (1/s)", "settling time to ±0.2° (s)"),
        (chattering, "Φ (m/s²)", "mean command change (rpm/sample)"),
        (adherent, "η (m/s³)", "largest error (deg)"),
        (collapse, "k/Φ (1/s)", "largest error (deg)"),
    )
    for ax, across, up in spans:
        assert (ax.get_xlabel(), ax.get_ylabel()) == (across, up)
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
        highest = max(np.max(y[np.isfinite(y)]) for _, y in curves(ax).values())
        assert ax.get_ylim()[1] > highest
    assert list(faster.get_yticks()) == [0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0]
    assert list(faster.get_xticks()) == [10.0, 40.0]
    assert [float(label) for label in curves(chattering)] == [10.0, 20.0, 40.0]
    assert [float(label) for label in curves(adherent)] == [0.32, 1.0, 3.2, 10.0, 32.0]
    limit_cycle = drawn["study_limit_cycle"].axes[0]
    assert (limit_cycle.get_xlabel(), limit_cycle.get_ylabel()) == (
        "time (s)",
        "tracking error (deg)",
    )
    assert limit_cycle.get_title().endswith("λ = 20 1/s")
    lines = curves(limit_cycle)
    shown = [c for c in by_hand.limit_cycle if c.lambda_per_s == GRID.limit_cycle_lambdas_per_s[0]]
    assert list(lines) == [case.variant for case in shown]
    for case in shown:
        assert lines[case.variant][1] == pytest.approx(case.error_deg)
