"""Results of the order study that several test files read."""

import itertools
import math

import pytest
from order_cases import (
    BRIEF,
    FORCE,
    NAMES,
    POSTURE,
)

from kneexo.parameters import UNCERTAIN_KNEE
from kneexo.studies.order.rows import (
    BandwidthRow,
    FrequencyRow,
    FrequencyTrace,
    SpeedRow,
    SwitchingRow,
    TrackingRow,
    TrackingTrace,
)
from kneexo.studies.order.study import (
    OrderResult,
    OrderSettings,
    order_study,
)

SMALL = OrderSettings(
    disturbances_n=(0.0, FORCE), postures_deg=(POSTURE,), switching_forces_n=(16.0,)
)


@pytest.fixture(scope="session")
def small():
    return order_study(BRIEF, SMALL)


@pytest.fixture(scope="session")
def by_hand():
    counter = itertools.count(1)

    def numbers(part, **labels):
        values = {name: round(0.00617 * next(counter), 5) for name in NAMES[part]}
        values |= {name: value / 5.0 for name, value in values.items() if "share" in name}
        if labels.get("order") == "full":
            gone = [name for name in values if name.startswith("load_pressure")]
        else:
            gone = [name for name in values if name.startswith(("cap", "rod_side"))]
        return labels | {k: v for k, v in values.items() if k not in gone}

    loads, postures = (0.0, 60.0, -60.0), (10.0, 40.0, 70.0)
    both = [(order, load) for load in loads for order in ("reduced", "full")]
    pressures = {"reduced": ("load_pressure",), "full": ("cap", "rod_side")}
    tracking = tuple(
        TrackingRow(
            **numbers("tracking", order=order, disturbance_n=load),
            trace=TrackingTrace(
                time_s=(0.0, 1.0, 2.0),
                error_deg=(0.1 + n, 0.2 + n, 0.3 + n),
                pressures_mpa={
                    name: (n + 0.5, n + 0.6, float(len(name))) for name in pressures[order]
                },
            ),
        )
        for n, (order, load) in enumerate(both)
    )
    frequency = [
        numbers("frequency", order=o, disturbance_n=f, posture_deg=p, stable=True, failure="")
        for o, f in both
        for p in postures
    ]
    lost = dict.fromkeys(NAMES["frequency"][3:], math.nan)
    frequency[0] |= dict.fromkeys(NAMES["frequency"][-2:], math.nan)
    frequency[1] |= lost | {"stable": False}
    frequency[2] |= lost | {"stable": None, "failure": "no rest"}
    return OrderResult(
        tracking=tracking,
        speeds=tuple(
            SpeedRow(**numbers("speeds", order=o, force_n=60.0, direction=d))
            for o in ("reduced", "full")
            for d in ("in", "out")
        ),
        switching=tuple(
            SwitchingRow(
                **numbers("switching", force_n=f, direction=d),
                oscillates=d == "in" and f == 16.0,
            )
            for d in ("in", "out")
            for f in (6.0, 16.0)
        ),
        frequency=tuple(
            FrequencyRow(**values, trace=FrequencyTrace((1.0, 10.0), (1e-3 * (n + 1), 2e-5 * n)))
            for n, values in enumerate(frequency)
        ),
        bandwidth=tuple(
            BandwidthRow(**numbers("bandwidth", order=o, disturbance_n=f), failure="")
            for o, f in both
        ),
        scenario=UNCERTAIN_KNEE,
        settings=OrderSettings(disturbances_n=loads, postures_deg=postures),
    )


@pytest.fixture(params=["by_hand", "small"])
def study(request):
    """Rows by hand, and those of a run."""
    return request.getfixturevalue(request.param)
