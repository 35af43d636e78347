"""The verdict on a run from its ``signals.csv``, in NumPy alone: nothing of kneexo is imported.

``verdict_table.json`` has sixty runs: preset, changes of its values, and what is right. ``python
tests/shared/verdict_table.py DIRECTORY`` reads ``NUMBER/signals.csv`` of each run, numbered from 0,
and writes what is right.
"""

import csv
import json
import math
import sys
from pathlib import Path

import numpy as np

TABLE = Path(__file__).with_name("verdict_table.json")
RUNS = json.loads(TABLE.read_text(encoding="utf-8"))
COMMAND_RPM, PRESSURE_PA, RELIEF_PA, POWER_W = 5000.0, 3.5e6, 3.5e6, 200.0
SAMPLE_S, SHARE = 0.002, 1.0 / 15.0


def share(reached):
    return float(np.mean(reached))


def limit_cycle_deg(reference, knee):
    """Half the swing of a knee that goes on moving while its reference rests, or None."""
    start = np.flatnonzero(np.abs(reference - reference[-1]) > 1e-4)[-1] + 1
    late = knee[(start + knee.size) // 2 :]
    before, last = np.array_split(late, 2)
    swing, distance = 0.5 * np.ptp(last), late - 0.5 * (late.max() + late.min())
    sides = np.sign(distance)[np.abs(distance) > 0.5 * swing]
    goes_on = swing > 1e-3 and np.ptp(last) > 0.9 * np.ptp(before)
    return swing if goes_on and np.count_nonzero(np.diff(sides)) >= 3 else None


def verdict(columns, values):
    """What is right for a run with these columns (n,) and these changes of its scenario."""
    time = columns["time_s"]
    reference, knee = (np.degrees(columns[f"knee_{name}_rad"]) for name in ("reference", "angle"))
    own = values.get("reference", {"kind": "sine"})
    period_s = 1.0 / values["reference.frequency_hz"] if own["kind"] == "sine" else 0.0
    long_enough = time[-1] + SAMPLE_S > 2.0 * period_s - 1e-9
    judged = time > (period_s if long_enough else 0.0) - 1e-9
    error = np.where(judged, np.abs(reference - knee), -1.0)
    tracks = error.max() <= 0.5 * np.ptp(reference) * SHARE
    if own["kind"] == "step":
        step = own["end_deg"] - own["start_deg"]
        tracks = abs(knee[-1] - own["end_deg"]) < 0.02 * abs(step)
    rpm = np.abs(columns["motor_speed_command_rad_s"]) * 30.0 / math.pi
    chambers = [columns[n] for n in ("cap_pressure_pa", "rod_side_pressure_pa") if n in columns]
    rests = own["kind"] in ("step", "ramp")
    return {
        "tracks": bool(tracks),
        "max_error_deg": float(error.max()),
        "max_error_time_s": float(time[error.argmax()]),
        "rms_error_deg": math.sqrt(np.mean(error[judged] ** 2)),
        "saturated_share": share(rpm > COMMAND_RPM * (1.0 - 1e-6)),
        "pressure_over_rating_share": share(np.abs(columns["load_pressure_pa"]) > PRESSURE_PA),
        "relief_share": share(np.max(chambers, axis=0) > RELIEF_PA) if chambers else None,
        "power_over_rating_share": share(np.abs(columns["shaft_power_w"]) > POWER_W),
        "limit_cycle_deg": limit_cycle_deg(reference, knee) if rests else None,
    }


def read(path):
    with path.open(encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    return dict(zip(names, np.array(rows, dtype=float).T, strict=True))


if __name__ == "__main__":
    for number, run in enumerate(RUNS.values()):
        signals = read(Path(sys.argv[1]) / str(number) / "signals.csv")
        run["right"] = verdict(signals, run["changes"])
    lines = [
        f"{json.dumps(name, ensure_ascii=False)}: {json.dumps(run, ensure_ascii=False)}"
        for name, run in RUNS.items()
    ]
    TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
