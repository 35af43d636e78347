import dataclasses
import math

import numpy as np
import pytest
from contest_cases import (
    made_up,
    metrics_of,
)

from kneexo.studies.contest.figures import figures


def test_the_outcome_shows_each_entrant_at_its_errors_and_margins(contest, curves, check_caption):
    drawn = figures(contest)
    for figure in drawn.values():
        check_caption(figure)
    here, there, margins, _ = drawn["contest"].axes
    share = (np.arange(len(contest.samples)) + 1.0) / len(contest.samples)

    def errors_of(assessed):
        return [values["max_error_deg"] for values in assessed]

    def distribution_of(assessed):
        """Errors of the runs that end, and their share of all plants."""
        errors = [error for error in errors_of(assessed) if not math.isnan(error)]
        return np.sort(errors), share[: len(errors)]

    named = curves(here)
    assert list(named) == list(contest.entrants)
    for n, name in enumerate(contest.entrants):
        errors, shares = distribution_of(contest.tested[name])
        x, y = named[name]
        assert x == pytest.approx(errors)
        assert y == pytest.approx(shares)
        errors, shares = distribution_of(contest.other_reference[name])
        x, y = there.lines[n].get_data()
        assert x == pytest.approx(errors)
        assert y == pytest.approx(shares)
        x, y = margins.lines[n].get_data()
        assert x == pytest.approx(errors_of(contest.tested[name]), nan_ok=True)
        expected = [values["disk_margin"] for values in contest.tested[name]]
        assert y == pytest.approx(expected, nan_ok=True)
        tuned = name in contest.settings.contestants
        for ax in (here, there):
            assert (ax.lines[n].get_linestyle() == "-") == tuned
        assert (margins.lines[n].get_marker() == "o") == tuned
        assert len({ax.lines[n].get_color() for ax in (here, there, margins)}) == 1
    least = contest.settings.least_disk_margin
    assert list(curves(margins)[f"(c) least in the tuning, {least:g}"][1]) == [least, least]
    assert {ax.get_xlabel() for ax in (here, there, margins)} == {"largest error (deg)"}
    assert {ax.get_xscale() for ax in (here, there, margins)} == {"log"}
    assert here.get_ylabel() == there.get_ylabel() == "share of the test plants"
    assert margins.get_ylabel() == "disk margin"
    task = contest.settings.other_reference
    assert there.get_title() == f"(b) {task.amplitude_deg:g}° at {task.frequency_hz:g} Hz"


def test_the_search_shows_the_best_of_each_generation(contest):
    (ax,) = figures(contest)["contest_search"].axes
    size = contest.settings.population
    for line, tuning in zip(ax.lines, contest.tunings, strict=True):
        assert line.get_label().startswith(tuning.contestant)
        assert ("not converged" in line.get_label()) is not tuning.converged
        # The first generation follows the population that it starts from.
        count = len(tuning.history_deg)
        assert line.get_xdata() == pytest.approx(size * np.arange(2, count + 2))
        feasible = [value if value < 90.0 else math.nan for value in tuning.history_deg]
        assert line.get_ydata() == pytest.approx(feasible, nan_ok=True)
        assert line.get_linestyle() == ("-" if tuning.seed == 1 else "--")
    assert (ax.get_xlabel(), ax.get_ylabel()) == (
        "evaluations",
        "mean of the largest errors (deg)",
    )
    contestants = [tuning.contestant for tuning in contest.tunings]
    colors = {(name, line.get_color()) for name, line in zip(contestants, ax.lines, strict=True)}
    assert len(colors) == len({color for _, color in colors}) == len(set(contestants))


def test_the_legend_names_everybody_once():
    *panels, key = figures(made_up())["contest"].axes
    assert all(ax.get_legend() is None for ax in panels)  # a legend hides no data
    legend = [text.get_text() for text in key.get_legend().get_texts()]
    assert legend == ["SMC", "PID", "SMC, default", "(c) least in the tuning, 0.5"]
    # Each entry has the line of (a) and (b) and the mark of (c).
    for n, handle in enumerate(key.get_legend().get_lines()[:3]):
        assert handle.get_linestyle() == panels[0].lines[n].get_linestyle()
        assert handle.get_marker() == panels[2].lines[n].get_marker()
        assert handle.get_color() == panels[0].lines[n].get_color()


def test_a_contest_whose_every_run_failed_is_drawn():
    study = made_up()
    failed = {name: [metrics_of(math.nan)] * 4 for name in study.tested}
    figure = figures(dataclasses.replace(study, tested=failed, other_reference=failed))["contest"]
    figure.canvas.draw()
    assert [ax.get_xlim() for ax in figure.axes[:3]] == [(0.1, 10.0)] * 3
