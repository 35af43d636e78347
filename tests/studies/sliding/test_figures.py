import math

import pytest

from kneexo.studies.sliding.figures import figures
from kneexo.studies.sliding.study import (
    LAWS,
)


def assert_line(line, x, y):
    """Abscissae and ordinates of a line are those of its case; nan where there is none."""
    assert line[0] == pytest.approx(x, nan_ok=True)
    assert line[1] == pytest.approx(y, nan_ok=True)


def test_every_line_of_the_figures_is_that_of_its_case(study, curves, check_caption):
    drawn = figures(study)
    for figure in drawn.values():
        check_caption(figure)
    assert set(drawn) == {"sliding_condition", "error_bound", "boundary_layer"}
    first = study.settings.loads_n[0]
    # Over time the smallest η with which the paper's k ends its run; the first load alone.
    same_law = study.of("motion", plant="full", law="paper", load_n=first)
    smallest = min(case.eta_m_s3 for case in same_law if not case.measured.failure)
    panels = ("start", study.settings.start_eta_m_s3, 1e3), ("motion", smallest, 1.0)
    for ax, (part, eta, scale) in zip(drawn["sliding_condition"].axes, panels, strict=True):
        lines = curves(ax)
        for case in study.of(part, plant="full", load_n=first, eta_m_s3=eta):
            trace = case.measured.trace
            if len(trace.outside_time_s):
                times = [scale * t for t in trace.outside_time_s]
                assert_line(lines.pop(LAWS[case.law]), times, trace.reaching_rate_m_s3)
        assert lines.pop(f"−η, η = {eta:g} m/s³")[1] == pytest.approx([-eta, -eta])
        assert lines == {}
        assert [list(line.get_ydata()) for line in ax.lines if line.get_label()[0] == "_"] == [
            [0.0, 0.0]
        ]
        assert ax.get_ylim() == pytest.approx((-2.5 * eta, 2.0 * eta))
        assert ax.get_xlabel() == ("time (ms)" if part == "start" else "time (s)")
        assert ax.get_ylabel() == "sgn(s)·ds/dt outside the layer (m/s³)"
        assert ax.get_title().endswith(f", {first:g} N".replace("-", "−"))
    for ax, load in zip(drawn["error_bound"].axes, study.settings.loads_n, strict=True):
        lines = curves(ax)
        for case in study.of("motion", plant="full", load_n=load, eta_m_s3=smallest):
            trace = case.measured.trace
            error = [1e3 * abs(e) for e in trace.error_m]
            assert_line(lines.pop(LAWS[case.law]), trace.time_s, error)
            if case.measured.failure:
                cross = lines.pop(f"{LAWS[case.law]}: leaves the range of motion")
                assert_line(cross, trace.time_s[-1:], error[-1:])
        assert lines.pop("Φ/λ² = 8 mm")[1] == pytest.approx([8.0, 8.0])
        assert lines == {}
        assert ax.get_title() == f"{load:g} N, η = {smallest:g} m/s³".replace("-", "−")
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("time (s)", "|e| (mm)")
    (ax,) = drawn["boundary_layer"].axes
    lines = curves(ax)
    for law, label in LAWS.items():
        for load in study.settings.loads_n:
            force = f"{load:g} N".replace("-", "−")
            same_law = study.of("motion", plant="full", law=law, load_n=load)
            failed = [case.eta_m_s3 for case in same_law if case.measured.failure]
            largest = [
                math.nan if case.measured.failure else case.measured.largest_s for case in same_law
            ]
            etas = [case.eta_m_s3 for case in same_law]
            assert_line(lines.pop(f"{label}, {force}"), etas, largest)
            if failed:
                assert_line(lines.pop(f"{label}, {force}: left the range"), failed, [40.0])
    assert lines.pop("edge of the layer")[1] == pytest.approx([1.0, 1.0])
    assert lines == {}
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("η (m/s³)", "largest |s|/Φ along the reference")
    needed = {"speed": study.needed.speed, "stability": study.needed.stability}
    marks = [line.get_xdata()[0] for line in ax.lines if line.get_color() == "0.5"]
    assert marks == list(needed.values())
    texts = {text.get_text().split()[-1]: text.get_position()[0] for text in ax.texts}
    assert texts == needed
