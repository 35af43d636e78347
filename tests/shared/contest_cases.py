"""Settings, numbers and helpers of the tests of the contest study."""

import math

from kneexo.parameters import (
    UNCERTAINTY,
    PidParameters,
    Scenario,
    SimulationParameters,
    SineReference,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.paths import changed
from kneexo.studies.contest.contest import (
    CONTESTANTS,
    Contestant,
    ContestResult,
    ContestSettings,
    Tuning,
)
from kneexo.studies.paper import PID_PAPER

BASE = Scenario(
    reference=SineReference(amplitude_deg=0.5, frequency_hz=10.0),
    simulation=SimulationParameters(duration_s=0.2),
)


def metrics_of(error, change=10.0, margin=0.8, stable=True, margins_failure=""):
    failed = math.isnan(error)
    return {
        "max_error_deg": error,
        "mean_command_change_rpm": math.nan if failed else change,
        "tracking_failure": "gone" if failed else "",
        "stable": stable,
        "disk_margin": margin if stable else math.nan,
        "margins_failure": margins_failure,
    }


SHARES = (0.01, 0.03, 0.97, 0.99)
"""Where the gains of a tuning lie between their bounds, by decades."""


def made_up():
    settings = ContestSettings(
        contestants={name: CONTESTANTS[name] for name in ("SMC", "PID")}, optimizer_seeds=(1, 2)
    )
    tunings = tuple(
        Tuning(
            name,
            seed,
            {
                path: span.low * (span.high / span.low) ** share
                for (path, span), share in zip(CONTESTANTS[name].gains.items(), SHARES, strict=True)
            },
            objective,
            64,
            converged,
            0.01,
            (95.0, 0.5),
        )
        for name, seed, objective, converged in (
            ("SMC", 1, 0.3, True),
            ("SMC", 2, 0.2, False),
            ("PID", 1, 95.0, False),
            ("PID", 2, 0.4, True),
        )
    )
    tested = {
        "SMC": [metrics_of(e, 10.0 + 10.0 * e, 0.8 - 0.1 * e) for e in (0.1, 0.2, 0.3, 0.4)],
        "PID": [metrics_of(e, 12.0, 0.9) for e in (0.05, 0.3, 0.5)]
        + [metrics_of(math.nan, stable=None, margins_failure="does not rest")],
        "SMC, default": [metrics_of(0.6, stable=False)] * 4,
    }
    other_reference = {
        name: [metrics_of(1.0 + n + 0.1 * k) for k in range(4)] for n, name in enumerate(tested)
    }
    entrants = {name: {"controller": {"kind": "smc"}} for name in tested}
    samples = tuple({"plant.cylinder.mass_kg": 1.5} for _ in range(4))
    return ContestResult(
        Scenario(),
        UNCERTAINTY,
        ("plant.load.knee_torque_n_m",),
        settings,
        12.0,
        tunings,
        entrants,
        samples,
        tested,
        other_reference,
    )


LAG = UncertaintySet(values={"plant.pump.lag_s": Uncertainty(low=0.005, high=0.02)})
SMALL = ContestSettings(
    contestants={
        "PI": Contestant(
            controller=PidParameters(),
            gains={
                "controller.proportional_per_s": Uncertainty(low=1.0, high=9.0, scale="log"),
                "controller.integral_per_s2": Uncertainty(low=0.1, high=40.0, scale="log"),
            },
        )
    },
    training_samples=1,
    test_samples=2,
    optimizer_seeds=(1, 2),
    population=5,
    generations=1,
    duration_s=0.2,
    other_reference=SineReference(amplitude_deg=0.2, frequency_hz=20.0),
    other_duration_s=0.1,
)


SMALL_STUDY = {
    # The study replaces duration and controller.
    "scenario": changed(BASE, {"simulation.duration_s": 7.0, "controller": PID_PAPER.model_dump()}),
    "uncertainty": LAG,
    "settings": SMALL,
}
"""Arguments of a study that takes about a second."""
