"""False alarms of the protection in healthy runs, and the levels of its residuals.

    python benchmarks/false_alarms.py [RUNS] [WORKERS]

The thresholds in ``kneexo/parameters/device/protection.py`` lie above the levels. The last case is
faster than the pump, so that a detector must stop the motor.
"""

import sys

from kneexo.analysis.faults.thresholds import detector_thresholds
from kneexo.parameters import Scenario, gait_reference, sit_to_stand_reference
from kneexo.parameters.task.gait import GAIT_STRIDE_S
from kneexo.parameters.uncertainty import UNCERTAIN_KNEE

STRIDES = {"reference": gait_reference(0.05, 2), "simulation.duration_s": 40.0}
RISING = {"reference": sit_to_stand_reference(8.0, 2), "simulation.duration_s": 24.0}
WALK = {"reference": gait_reference(1 / GAIT_STRIDE_S, 10), "simulation.duration_s": 8.9}
CASES = {  # scenario, changed values, share of the runs
    "training, 0.1 Hz sine": (UNCERTAIN_KNEE, {}, 1.0),
    "training with PID": (UNCERTAIN_KNEE, {"controller": "pid"}, 0.1),
    "strides of 20 s": (UNCERTAIN_KNEE, STRIDES, 0.1),
    "sit to stand in 8 s": (UNCERTAIN_KNEE, RISING, 0.1),
    "preset leg, training": (Scenario.preset("leg"), {}, 0.1),
    "preset wearer, sit to stand in 8 s": (Scenario.preset("wearer"), RISING, 0.05),
    "strides of 0.89 s": (UNCERTAIN_KNEE, WALK, 0.02),
}


def main(runs: int = 10_000, workers: int = 1) -> None:
    """Print a table for each case."""
    for name, (scenario, values, share) in CASES.items():
        protected = scenario.changed({"protection": {}, **values})
        result = detector_thresholds(protected, runs=max(1, int(share * runs)), workers=workers)
        print(f"\n{name}\n{result}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
