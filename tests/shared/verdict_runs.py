"""Sixty runs whose verdicts are checked: the numbers that make their scenarios, no more."""

PID = {"controller": {"kind": "pid"}}
QUICK = {"reference.frequency_hz": 0.25, "reference.amplitude_deg": 10.0}
SATURATED = {"reference.frequency_hz": 0.5}
SPANS_S = (2.0, 4.0, 4.002, 4.1, 6.0, 7.996, 7.998, 8.0, 10.0, 12.0)
"""1/2 … 3 periods of QUICK; from 7.998 s on there are samples for two periods."""


def fault(place, kind, size, start_s, duration_s=None):
    values = {"place": place, "kind": kind, "size": size, "start_s": start_s}
    return {"faults": [values | ({"duration_s": duration_s} if duration_s else {})]}


DEAD = ("command", "scale", 0.0)
FAULTS = {
    "dead command, first period": fault(*DEAD, 1.0, 1.0),
    "dead command, second period": fault(*DEAD, 5.0, 1.0),
    "dead command, end": fault(*DEAD, 8.5),
    "encoder jumps back": fault("encoder", "offset", 4.0, 2.0, 1.0),
    "encoder jumps": fault("encoder", "offset", 4.0, 6.0),
    "encoder drifts": fault("encoder", "drift", 0.5, 3.0),
    "leak": fault("plant.cylinder.leakage_m3_per_s_pa", "value", 1e-9, 2.0),
}
HOLE = [(0, 30), (1, 45), (2, 55), (6, 25), (7, 30)]
STEP = {"kind": "step", "start_deg": 30.0, "end_deg": 50.0, "time_s": 1.0}
RAMP = {"kind": "ramp", "start_deg": 20.0, "end_deg": 50.0, "rate_deg_s": 15.0, "time_s": 1.0}


def push(torque, duration_s):
    return {"torque_n_m": torque, "start_s": 1.0, "duration_s": duration_s}


def samples(factor):
    times, angles = zip(*((factor * time, angle) for time, angle in HOLE), strict=True)
    return {"kind": "samples", "times_s": times, "angles_deg": angles}


def during(duration_s, **values):
    return values | {"simulation.duration_s": duration_s}


RUNS = {
    **{
        f"{preset} {law}, sine of 4 s, {span_s:g} s": (
            preset,
            during(span_s, **QUICK, **changes),
        )
        for preset, law, changes in (
            ("paper", "smc", {}),
            ("paper", "pid", PID),
            ("leg", "smc", {}),
        )
        for span_s in SPANS_S
    },
    "paper pid, 0.05 Hz, 21 s": (
        "paper",
        during(
            21.0,
            **{
                "controller": {"kind": "pid", "proportional_per_s": 1.5},
                "reference.frequency_hz": 0.05,
            },
        ),
    ),
    **{
        f"{preset}, saturated, {span_s:g} s": (preset, during(span_s, **SATURATED))
        for preset in ("paper", "leg")
        for span_s in (2.02, 5.0)
    },
    **{
        f"{preset}, pushed by {torque:g} N·m": (
            preset,
            during(5.0, **QUICK, **load, push=push(torque, duration_s)),
        )
        for preset, torque, duration_s, load in (
            ("paper", 150.0, 0.3, {"plant.load": "knee"}),
            ("leg", 150.0, 0.1, {}),
            ("leg", -150.0, 0.03, {}),
        )
    },
    **{f"leg, {name}": ("leg", during(9.0, **QUICK, **values)) for name, values in FAULTS.items()},
    **{
        f"protected, {name}": ("protected", during(9.0, **QUICK, **values))
        for name, values in FAULTS.items()
        if name != "leak"
    },
    **{
        f"{preset}, hole in samples, {factor:g} times": (
            preset,
            during(7.0 * factor, reference=samples(factor)),
        )
        for preset in ("paper", "leg")
        for factor in (0.4, 1.0)
    },
    **{
        f"{preset}, rests after a {reference['kind']}": (
            preset,
            during(10.0, reference=reference),
        )
        for preset in ("paper", "leg")
        for reference in (STEP, RAMP)
    },
    "bench, rests after a ramp": ("bench", during(10.0, reference=RAMP)),
}
"""Preset and changes of each run, by its name."""
