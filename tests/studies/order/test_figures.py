import numpy as np
import pytest
from order_cases import (
    rows,
)

from kneexo.studies.order.figures import figures
from kneexo.studies.order.study import (
    switching_force_n,
)


def assert_line(line, x, y):
    """Abscissae and ordinates of a line are those of its row."""
    assert line[0] == pytest.approx(list(x))
    assert line[1] == pytest.approx(list(y))


def test_every_line_of_the_figures_is_that_of_its_row(study, curves, check_caption):
    drawn = figures(study)
    for figure in drawn.values():
        check_caption(figure)
    assert set(drawn) == {"order_tracking", "order_switching", "order_frequency"}
    pressures = {"P_L, reduced": "load_pressure", "P_1, full": "cap", "P_2, full": "rod_side"}
    loads = study.settings.disturbances_n
    panels = np.reshape(drawn["order_tracking"].axes, (len(loads), 2))
    for (error, pressure), load in zip(panels, loads, strict=True):
        assert error.get_title() == f"disturbance {load:g} N".replace("-", "−")
        assert (error.get_ylabel(), pressure.get_ylabel()) == ("error (deg)", "pressure (MPa)")
        lines, shown = curves(error), curves(pressure)
        cases = rows(study.tracking, disturbance_n=load)
        assert set(lines) == {row.order for row in cases} == {"reduced", "full"}
        assert set(shown) == set(pressures)
        for row in cases:
            trace = row.trace
            assert_line(lines[row.order], trace.time_s, trace.error_deg)
            for label, name in pressures.items():
                if name in trace.pressures_mpa:
                    assert_line(shown[label], trace.time_s, trace.pressures_mpa[name])
        (zero,) = (line for line in error.lines if line.get_label().startswith("_"))
        assert list(zero.get_ydata()) == [0.0, 0.0]
    assert [ax.get_xlabel() for ax in panels[-1]] == ["time (s)", "time (s)"]
    first = panels[0, 0]
    assert all(first.get_shared_x_axes().joined(first, ax) for ax in panels.flat)
    (ax,) = drawn["order_switching"].axes
    lines = curves(ax)
    for label, direction in (("retracting", "in"), ("extending", "out")):
        cases = rows(study.switching, direction=direction)
        swings = [row.velocity_swing_mm_s for row in cases]
        assert_line(lines[label], [row.force_n for row in cases], swings)
    (label,) = (label for label in lines if label.startswith("P_r"))
    force = switching_force_n(study.scenario)
    assert lines[label][0] == pytest.approx([force, force])
    assert label == f"P_r(A_1 − A_2) = {force:.1f} N"
    assert ax.get_xlabel() == "force on the rod (N)"
    assert ax.get_ylabel() == "swing of the rod's velocity about v_d (mm/s)"
    (ax,) = drawn["order_frequency"].axes
    lines = curves(ax)
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_title()) == (
        "frequency (Hz)",
        "rod velocity per command (mm/rad)",
        "plant at 40°",
    )
    cases = rows(study.frequency, posture_deg=40.0)
    for row in cases:
        trace = row.trace
        gain = [1e3 * value for value in trace.plant_gain_m]
        line = lines.pop(f"{row.order}, {row.disturbance_n:g} N".replace("-", "−"))
        assert_line(line, trace.frequencies_hz, gain)
    assert lines.pop("Nyquist, 250 Hz")[0] == pytest.approx([250.0, 250.0])
    assert lines == {}
    # An order has a colour, a load a dash: lines of two loads may coincide.
    styles = {(line.get_color(), line.get_linestyle()) for line in ax.lines[: len(cases)]}
    assert len(styles) == len(cases) == 2 * len(loads)
