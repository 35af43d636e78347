"""Results of the sliding study that several test files read."""

from dataclasses import replace

import pytest
from sliding_cases import (
    SHORT,
    SMALL,
)

from kneexo.studies.sliding.condition import SlidingMeasurement, SlidingTrace
from kneexo.studies.sliding.settings import SLIDING_LAW, SlidingSettings
from kneexo.studies.sliding.study import (
    LAWS,
    NeededEta,
    SlidingCase,
    SlidingResult,
    sliding_study,
)
from kneexo.sweeps.checkpoint import Checkpoint


@pytest.fixture(scope="session")
def small_study(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "checkpoint"
    return sliding_study(SHORT, SMALL, checkpoint=Checkpoint(path)), path


SHARES = ("outside_share", "holding_share", "attracting_share", "left_share")
SHARES += ("held_share", "mean_share")
SHARES += ("error_share", "rate_share", "acceleration_share", "bounded_share")
NUMBERS = ("largest_s", "largest_error_mm", "worst_rate_m_s3", "reaching_s", "promised_s")
NUMBERS += ("duration_s",)


@pytest.fixture(scope="session")
def by_hand():
    """Cases in which no two numbers are equal; one leaves the range, one never the layer."""
    cases = []

    def case(part, plant, law, load, eta, **changes):
        n = len(cases) + 1
        values = {name: 0.01 * n + 0.001 * k for k, name in enumerate(SHARES)}
        values |= {name: 1.1 * n + 0.1 * k for k, name in enumerate(NUMBERS)}
        trace = SlidingTrace(
            time_s=[0.0, 0.5, 1.0],
            s_m_s2=[0.1 * n] * 3,
            error_m=[1e-3 * n, -2e-3 * n, 3e-3 * n],
            bound_m=[8e-3] * 3,
            outside_time_s=[0.1 * n, 0.2 * n],
            reaching_rate_m_s3=[-1e3 * n, -2e3 * n],
        )
        measured = SlidingMeasurement(**values, failure="", trace=trace)
        cases.append(SlidingCase(part, plant, law, load, eta, replace(measured, **changes)))

    for law in LAWS:
        for load in (60.0, -60.0):
            # By its own k s stays from 2e4 m/s³ on, completed from 1e4 m/s³ on.
            for eta in (1e4, 2e4):
                stays = {"left_share": 0.0} if eta > 1e4 or law != "paper" else {}
                case("motion", "full", law, load, eta, **stays)
            case("start", "full", law, load, 2e4)
    left_the_range = replace(cases[0].measured, failure="left the range")
    cases[0] = replace(cases[0], measured=left_the_range)
    for eta in (1e4, 2e4):
        case("motion", "reduced, 1.4 kg", "paper", 60.0, eta, left_share=0.0, outside_share=0.0)
    case("start", "reduced, 1.4 kg", "paper", 60.0, 2e4, left_share=0.0, holding_share=1.0)
    case("sampled", "full, motor", "paper", 60.0, 2.8e5)
    return SlidingResult(
        cases=tuple(cases),
        needed=NeededEta(speed=3.3e4, stability=8.1e4),
        scenario=SLIDING_LAW,
        settings=SlidingSettings(etas_m_s3=(1e4, 2e4), loads_n=(60.0, -60.0), start_eta_m_s3=2e4),
    )


@pytest.fixture(params=["by hand", "run"])
def study(request):
    """Cases by hand, and those of runs."""
    if request.param == "by hand":
        return request.getfixturevalue("by_hand")
    return request.getfixturevalue("small_study")[0]
