"""Tracking metrics that the compiled engine computes inside its time loop, without a log."""

from __future__ import annotations

from collections.abc import Sequence

from diagramc import Reduction
from kneexo.analysis.signals import settled_s
from kneexo.analysis.tracking.interaction import INTERACTION_METRICS
from kneexo.analysis.tracking.reductions import (
    all_metrics,
    basic_metrics,
    basic_reductions,
    reduce_signals,
    scenario_reductions,
    torque_reductions,
)
from kneexo.analysis.tracking.tracking import TrackingMetrics
from kneexo.parameters import Scenario
from kneexo.simulation import can_reduce, needs_runs, reduce_run, simulate


@needs_runs
def track_basic_metrics(scenario: Scenario) -> dict[str, float]:
    """Simulate a scenario and return its `TRACKING_METRICS`.

    With a wearer the result has the `INTERACTION_METRICS` too, of the samples from `settled_s` on.
    If `can_reduce` accepts the scenario, the compiled engine computes the metrics inside
    its time loop, without a log. Otherwise the run logs the signals, and NumPy computes the
    metrics. The two ways round sums differently.
    """
    begin_s = settled_s(scenario)
    basic = basic_reductions(begin_s, scenario.command_limit_rad_s)
    more = torque_reductions(begin_s) if scenario.wearer.kind != "none" else ()
    values = _values(scenario, basic + more)
    torques = dict(zip(INTERACTION_METRICS, values[len(basic) :], strict=False))
    return basic_metrics(values[: len(basic)]) | torques


@needs_runs
def track_metrics(scenario: Scenario) -> TrackingMetrics:
    """Simulate a scenario and return the metrics of `track`.

    As in `track_basic_metrics`, the compiled engine computes the metrics without a log.
    """
    reductions = scenario_reductions(scenario, settled_s(scenario))
    return TrackingMetrics(**all_metrics(_values(scenario, reductions)))


def _values(scenario: Scenario, reductions: tuple[Reduction, ...]) -> Sequence[float]:
    """Simulate a scenario and return the values of ``reductions``."""
    # To write 15,000 samples of five signals takes longer than to compute them.
    if can_reduce(scenario):
        values: Sequence[float] = reduce_run(scenario, reductions).tolist()
        return values
    outputs = [output for r in reductions for output in (r.output, r.minus) if output]
    names = dict.fromkeys(output.partition("[")[0] for output in outputs)
    run = simulate(scenario, signals=tuple(names))
    return reduce_signals(reductions, run.time_s, run.data)
