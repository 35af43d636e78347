"""A fit that is made up, so that nothing runs: two numbers, a sensor, and a second estimate."""

from dataclasses import replace
from functools import cache

import numpy as np

from diagramc import Fit, Unknown
from kneexo.analysis.identification.fit import FittedScenario
from kneexo.parameters import Scenario

LAG, LOAD, DELAY = "plant.pump.lag_s", "plant.load.segment_mass_kg", "encoder_reading.delay_s"
UNKNOWNS = (
    Unknown(LAG, 0.001, 0.1, 0.01, "s"),
    Unknown(LOAD, 0.16, 16.0, 1.6, "kg"),
    Unknown(DELAY, 0.0, 0.02, 0.002, "s"),
)


@cache
def made_up():
    names = (LAG, LOAD, DELAY)
    values = dict(zip(names, (0.0125, 2.25, 0.004), strict=True))
    ends = ((0.012, 0.013), (0.75, 16.0), (0.0, 0.02))
    outputs = ("encoder_reading", "motor_speed")
    open_loop = Fit(
        UNKNOWNS,
        names,
        values,
        dict(zip(names, ends, strict=True)),
        dict(zip(names, ("bounded", "one-sided", "flat"), strict=True)),
        np.diag([9e-8, 0.16, 4e-6]),
        dict(zip(outputs, (0.0005, 1.5), strict=True)),
        dict(zip(outputs, (0.006, 0.002), strict=True)),
        dict(zip(outputs, (98.25, 99.5), strict=True)),
        dict(zip(outputs, (97.75, 99.25), strict=True)),
        (np.zeros((6, 2)),),
        dict(zip(outputs, (0.001, 0.625), strict=True)),
        ("encoder_reading: the residuals are not white",),
        None,
        np.full(3, 0.5),
        np.ones(3),
    )
    whole = dict(zip(names, (0.0145, 2.75, 0.004), strict=True))
    whole_loop = replace(open_loop, values=whole, covariance=np.diag([1.6e-7, 0.09, 4e-6]))
    time_s = np.array([0.0, 0.002, 0.004, 0.006, 0.008, 0.01])
    measured = {
        "encoder_reading_rad": np.array([2.0, 2.1, 2.2, 2.3, 2.4, 2.5]),
        "motor_speed_rad_s": np.array([0.0, 10.0, 30.0, 50.0, 60.0, 50.0]),
    }
    predicted = {
        "encoder_reading_rad": np.array([2.1, 2.2, 2.2, 2.2, 2.2, 2.2]),
        "motor_speed_rad_s": np.array([1.0, 11.0, 31.0, 51.0, 61.0, 51.0]),
    }
    trained = np.array([True, True, True, True, False, False])
    return FittedScenario(
        Scenario(
            plant={"load": {"kind": "knee", "segment_mass_kg": 2.25}, "pump": {"lag_s": 0.0125}}
        ),
        "bench.csv",
        (LAG, LOAD),
        time_s,
        measured,
        predicted,
        trained,
        open_loop,
        whole_loop,
        ("motor_speed_command_rad_s: is at its limit in 12 % of the rows",),
    )
