"""What single precision costs: the exported controller in C, replayed and in closed loop.

    python benchmarks/float_loop.py [--duration SECONDS]

The closed loop is the exported controller with the exported plant, which is in double precision.
A row for the controller in double, in float, and in float with plain sums instead of compensated
ones (Kahan): root mean square and largest error of the knee angle; samples at which the encoder's
count differs from that of double; the largest difference of a command. The last column is the
replay: the largest difference from the compiled controller for the same inputs, where no count can
flip. The last line is what compensated sums are for: a long sum of small terms.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from exported import Loop, Replay, exported_source, replayed, without_kahan
from pydrake.systems.primitives import DiscreteTimeIntegrator

from diagramc import read_diagram
from diagramc.c.source import source_of
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import UNCERTAIN_KNEE
from kneexo.studies.paper import PID_TUNED

sys.path.append(str(Path(__file__).parents[1] / "examples"))
from backstepping import BACKSTEPPING

DURATION_S = 30.0
TICK_S = 0.002
RPM = 2.0 * math.pi / 60.0

SCENARIOS = {
    "SMC": Scenario(),
    "SMC, shank's weight": UNCERTAIN_KNEE,
    "SMC, plain differences": changed(Scenario(), {"estimator": {"kind": "difference"}}),
    "PID, 5 1/s": changed(Scenario(), {"controller": {"kind": "pid"}}),
    "PID, tuned": Scenario(controller=PID_TUNED),
    "backstepping": BACKSTEPPING,
}


class Row(NamedTuple):
    """Figures of a controller in one precision."""

    controller: str
    precision: str
    rms_error_deg: float
    largest_error_deg: float
    counts: int
    """Samples at which the encoder's count differs from that of double."""
    command_rpm: float
    """Largest difference of a command from that of double."""
    replay_rpm: float
    """Largest difference of a command from the compiled controller, for the same inputs."""


def rows(name: str, scenario: Scenario, duration_s: float = DURATION_S) -> Iterator[Row]:
    """Double, float, and float with plain sums."""
    scenario = changed(scenario, {"simulation.duration_s": duration_s})
    diagram, double = exported_source(scenario, "controller")
    _, single = exported_source(scenario, "controller", "float")
    recorded = replayed(scenario, diagram, double, duration_s)
    sources = {"double": double, "float": single, "float, plain sums": without_kahan(single)}
    base = Loop(scenario, double).run(duration_s)
    for precision, source in sources.items():
        run = Loop(scenario, source).run(duration_s)
        error_deg = np.degrees(run["knee_angle_rad"] - run["knee_reference_rad"])
        command, count = "motor_speed_command_rad_s", "encoder_count"
        replay = np.abs(Replay(source)(recorded.inputs) - recorded.outputs)
        yield Row(
            name,
            precision,
            float(np.sqrt(np.mean(error_deg**2))),
            float(np.abs(error_deg).max()),
            int(np.count_nonzero(run[count] != base[count])),
            float(np.abs(run[command] - base[command]).max()) / RPM,
            float(replay.max()) / RPM,
        )


def hour_in_float() -> dict[str, float]:
    """The time after an hour by a sum of 2 ms, in s: compensated and plain."""
    clock = DiscreteTimeIntegrator(1, TICK_S)
    source = source_of(read_diagram(clock, inputs=("u",)), "clock", precision="float")
    rate = np.ones((round(3600.0 / TICK_S), 1))
    return {
        "compensated": float(Replay(source)(rate)[-1, 0]),
        "plain": float(Replay(without_kahan(source))(rate)[-1, 0]),
    }


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--duration", type=float, default=DURATION_S, metavar="SECONDS")
    duration_s = parser.parse_args(arguments).duration
    print(f"{duration_s:g} s of closed loop")
    print("controller | precision | rms, max error (deg) | counts | command (rpm) | replay (rpm)")
    for name, scenario in SCENARIOS.items():
        for row in rows(name, scenario, duration_s):
            print(
                f"{row.controller} | {row.precision} | {row.rms_error_deg:.5f}, "
                f"{row.largest_error_deg:.4f} | {row.counts} | {row.command_rpm:.3g} | "
                f"{row.replay_rpm:.2g}"
            )
    hour = ", ".join(f"{time_s:.3f} s with {sums} sums" for sums, time_s in hour_in_float().items())
    print(f"an hour as a sum of 2 ms in float: {hour}")


if __name__ == "__main__":
    main()
