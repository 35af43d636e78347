"""Error of the reduced-order model of the cylinder (Eq. 15), relative to the full-order model.

In time, the study compares tracking, the rod's speed at the motor's limit, and the motion near the
switching force P_r (A_1 − A_2), where the loaded chamber changes back and forth. In frequency, it
compares the oil's mode, the margins and the small-signal bandwidth of the sampled loop for each
posture and load, and the large-signal bandwidth for each load.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, TypeVar, Unpack

import numpy as np
from pydantic import TypeAdapter

from kneexo.analysis.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.frequency_response import require_sine
from kneexo.analysis.plant_linearization import linearize_plant
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.signals import rms, saturated_share
from kneexo.analysis.tracking import track
from kneexo.errors import KneexoError, LinearizationError, ParameterError
from kneexo.parameters import (
    UNCERTAIN_KNEE,
    FullCylinderParameters,
    KneeLoadParameters,
    RampReference,
    Scenario,
)
from kneexo.parameters.paths import changed
from kneexo.parameters.quantity import Parameters, quantities, quantity
from kneexo.result import Result
from kneexo.simulation import awaitable, needs_runs, simulate
from kneexo.studies.order.rows import (
    BandwidthRow,
    FrequencyRow,
    FrequencyTrace,
    SpeedRow,
    SwitchingRow,
    TrackingRow,
    TrackingTrace,
)
from kneexo.sweeps import SweepOptions, open_sweep


class OrderSettings(Parameters):
    """Settings of the study `order`: loads, postures and motions."""

    disturbances_n: tuple[float, ...] = quantities(
        (0.0, 60.0, -60.0),
        "N",
        "assumption: none, and enough for P_1 or P_2 to carry the load throughout",
        ge=-1e4,
        le=1e4,
    )
    postures_deg: tuple[float, ...] = quantities(
        (10.0, 40.0, 70.0), "deg", "Section 5: ends and middle of 10…70°", ge=0, le=90
    )
    speed_rate_deg_s: float = quantity(
        60.0, "deg/s", "assumption: beyond the speed limit at every posture", ge=1e-3, le=1e4
    )
    switching_forces_n: tuple[float, ...] = quantities(
        tuple(float(force) for force in range(41)),
        "N",
        "assumption: about the switching force P_r (A_1 − A_2) = 15.7 N",
        ge=-1e4,
        le=1e4,
    )
    switching_rate_deg_s: float = quantity(
        15.0, "deg/s", "assumption: two thirds of what the speed limit allows", ge=1e-3, le=1e4
    )
    switching_step_s: float = quantity(
        2e-5,
        "s",
        "assumption: step of rk4, which takes the many openings of the valves better than an "
        "exact hold; a third of the make-up valve's time constant",
        ge=1e-7,
        le=1e-3,
    )
    oscillation_m_s: float = quantity(
        0.010,
        "m/s",
        "assumption: peak to peak of the rod's velocity about its reference that counts as "
        "oscillation; without, a tenth of it is left",
        ge=1e-6,
        le=10,
    )


ORDERS = ("reduced", "full")
"""Names of the compared models of the cylinder: reduced (Eq. 15) and full (Eq. 14)."""

Row = TypeVar("Row")

_TRACE_POINTS = 800
_START_S = 0.5
"""Time in s after the start of a ramp during which nothing is measured."""


def in_order(scenario: Scenario, order: str, disturbance_n: float = 0.0) -> Scenario:
    """Return the scenario with one of the `ORDERS` and an additional constant force on the rod.

    If the scenario has no load, it gets a load without weight.
    """
    plant = scenario.plant
    load = plant.load if plant.load.kind == "knee" else KneeLoadParameters(segment_mass_kg=0.0)
    full = plant.full_order or FullCylinderParameters()
    values = {
        "plant.load": dict(load) | {"disturbance_n": load.disturbance_n + disturbance_n},
        "plant.full_order": dict(full) if order == "full" else None,
    }
    return changed(scenario, values)


def _without_weight(scenario: Scenario, order: str, force_n: float) -> Scenario:
    """Return the scenario with one of the `ORDERS`, and a constant force as the rod's only load."""
    load = KneeLoadParameters(segment_mass_kg=0.0)
    return in_order(changed(scenario, {"plant.load": dict(load)}), order, force_n)


# -------------------------------------------------------------------- pieces of the work
# Each returns a row as plain data, which a checkpoint can store.


@needs_runs
async def tracking_row(scenario: Scenario, case: tuple[str, float]) -> dict[str, Any]:
    """Return the `TrackingRow` of a run.

    ``case`` is the order and the constant force in N added to the load.
    """
    order, force = case
    tracked = await awaitable(track, in_order(scenario, order, force), all_signals=True)
    run, metrics = tracked.run, tracked.metrics
    if order == "full":
        pressures = {name: 1e-6 * run[f"{name}_pressure_pa"] for name in ("cap", "rod_side")}
        relief = run["cap_relief_flow_m3_s"] + run["rod_side_relief_flow_m3_s"]
        makeup = np.abs(run["cap_makeup_flow_m3_s"] + run["rod_side_makeup_flow_m3_s"])
        numbers = {
            "relief_share": float(np.mean(relief > 0.0)),
            "peak_makeup_cm3_s": 1e6 * float(makeup.max()),
        }
    else:
        pressures, numbers = {"load_pressure": 1e-6 * run["load_pressure_pa"]}, {}
    for name, values in pressures.items():
        numbers[f"{name}_min_mpa"] = float(values.min())
        numbers[f"{name}_max_mpa"] = float(values.max())
    every = max(1, run.time_s.size // _TRACE_POINTS)
    trace = TrackingTrace(
        time_s=tuple(run.time_s[::every].tolist()),
        error_deg=tuple(tracked.error_deg[::every].tolist()),
        pressures_mpa={name: tuple(values[::every].tolist()) for name, values in pressures.items()},
    )
    row = TrackingRow(
        order=order,
        disturbance_n=force,
        max_error_deg=metrics.max_error_deg,
        rms_error_deg=metrics.rms_error_deg,
        mean_command_change_rpm=metrics.mean_command_change_rpm,
        saturated_share=metrics.saturated_share,
        trace=trace,
        **numbers,
    )
    return asdict(row)


def _ramp(
    scenario: Scenario, order: str, force: float, flexing: bool, rate_deg_s: float
) -> Scenario:
    """Return the scenario with a ramp reference, and a constant force as the rod's only load.

    The ramp covers the range of the scenario's reference, upwards if ``flexing``.
    """
    low, high = scenario.reference.range_deg
    start, end = (low, high) if flexing else (high, low)
    ramp = RampReference(start_deg=start, end_deg=end, time_s=0.0, rate_deg_s=rate_deg_s)
    return changed(_without_weight(scenario, order, force), {"reference": dict(ramp)})


@needs_runs
async def speed_row(
    scenario: Scenario, settings: OrderSettings, case: tuple[str, float, bool]
) -> dict[str, Any]:
    """Return the `SpeedRow` of a run.

    ``case`` is the order, the constant force in N, and True for flexion.
    """
    order, force, flexing = case
    fast = _ramp(scenario, order, force, flexing, settings.speed_rate_deg_s)
    fast = changed(fast, {"simulation.duration_s": 1.0})
    run = await awaitable(simulate, fast, signals=("rod_velocity", "motor_speed_command"))
    late = run.time_s >= _START_S
    command = run["motor_speed_command_rad_s"][late]
    row = SpeedRow(
        order=order,
        force_n=force,
        direction="in" if flexing else "out",
        saturated_share=saturated_share(command, fast.command_limit_rad_s),
        rod_speed_mm_s=1e3 * float(np.mean(np.abs(run["rod_velocity_m_s"][late]))),
    )
    return asdict(row)


@needs_runs
async def switching_row(
    scenario: Scenario, settings: OrderSettings, case: tuple[float, bool]
) -> dict[str, Any]:
    """Return the `SwitchingRow` of a run.

    ``case`` is the constant force on the rod in N, and True for flexion.
    """
    force, flexing = case
    low, high = scenario.reference.range_deg
    slow = _ramp(scenario, "full", force, flexing, settings.switching_rate_deg_s)
    duration = 0.95 * (high - low) / settings.switching_rate_deg_s
    if duration <= _START_S:
        raise ParameterError(
            f"switching_rate_deg_s = {settings.switching_rate_deg_s:g} deg/s: the "
            f"{high - low:g} deg of the reference take {duration:g} s, must take > {_START_S:g} s"
        )
    run = await awaitable(
        simulate,
        changed(slow, {"simulation.duration_s": duration}).with_steps(settings.switching_step_s),
        signals=(
            *("rod_velocity", "rod_reference", "knee_angle", "knee_reference"),
            "chamber_pressures",
        ),
    )
    late = run.time_s >= _START_S
    velocity = (run["rod_velocity_m_s"] - run["rod_reference_velocity_m_s"])[late]
    error = (run["knee_angle_rad"] - run["knee_reference_rad"])[late]
    across = (run["cap_pressure_pa"] - run["rod_side_pressure_pa"])[late]
    row = SwitchingRow(
        force_n=force,
        direction="in" if flexing else "out",
        velocity_swing_mm_s=1e3 * float(np.ptp(velocity)),
        velocity_rms_mm_s=1e3 * rms(velocity - velocity.mean()),
        load_pressure_swing_mpa=1e-6 * float(np.ptp(across)),
        max_error_deg=math.degrees(float(np.max(np.abs(error)))),
        oscillates=bool(np.ptp(velocity) > settings.oscillation_m_s),
    )
    return asdict(row)


def frequency_row(scenario: Scenario, case: tuple[str, float, float]) -> dict[str, Any]:
    """Return the `FrequencyRow` of one posture.

    ``case`` is the order, the constant force in N added to the load, and the knee angle in deg. If
    a linearization fails, its numbers are nan and ``failure`` has the reason.
    """
    order, force, posture = case
    at = in_order(scenario, order, force)
    row = FrequencyRow(order=order, disturbance_n=force, posture_deg=posture)
    try:
        plant = linearize_plant(at.plant, knee_angle_deg=posture, outputs=("rod_velocity",))
        mode = plant.poles[np.argmax(plant.poles.imag)]
        oscillates = mode.imag > 0.0
        grid = np.geomspace(1.0, 1000.0, 400)
        row = replace(
            row,
            mode_hz=float(abs(mode) / (2.0 * math.pi)) if oscillates else math.nan,
            mode_damping=float(-mode.real / abs(mode)) if oscillates else math.nan,
            rod_force_n=plant.operating_point.rod_force_n,
            trace=FrequencyTrace(
                tuple(grid.tolist()), tuple(np.abs(plant.response(grid)).tolist())
            ),
        )
        loop = linearize_loop(at, knee_angle_deg=posture)
        row = replace(row, stable=loop.stable)
        if loop.stable:
            margins = loop.margins()
            row = replace(
                row,
                phase_margin_deg=margins.phase_margin_deg,
                gain_margin=margins.gain_margin,
                delay_margin_ms=1e3 * margins.delay_margin_s,
                disk_margin=margins.disk_margin,
                bandwidth_hz=loop.bandwidth_hz(),
                complementary_sensitivity_bandwidth_hz=(
                    loop.complementary_sensitivity_bandwidth_hz()
                ),
            )
    except LinearizationError as error:
        row = replace(row, failure=str(error))
    return asdict(row)


@needs_runs
async def bandwidth_row(scenario: Scenario, case: tuple[str, float]) -> dict[str, Any]:
    """Return the `BandwidthRow` for one order and load.

    ``case`` is the order and the constant force in N added to the load. If the search fails, the
    bandwidth is nan and ``failure`` has the reason.
    """
    order, force = case
    bandwidth, failure = math.nan, ""
    try:
        bandwidth = await awaitable(large_signal_bandwidth_hz, in_order(scenario, order, force))
    except KneexoError as error:
        failure = str(error)
    row = BandwidthRow(order=order, disturbance_n=force, bandwidth_hz=bandwidth, failure=failure)
    return asdict(row)


# -------------------------------------------------------------------------------- result


@dataclass(frozen=True, repr=False)
class OrderResult(Result):
    """Tables of the comparison, with a row for each order and load.

    A table that depends on the posture has a row for each posture too.
    """

    tracking: tuple[TrackingRow, ...]
    speeds: tuple[SpeedRow, ...]
    switching: tuple[SwitchingRow, ...]
    frequency: tuple[FrequencyRow, ...]
    bandwidth: tuple[BandwidthRow, ...]
    scenario: Scenario
    settings: OrderSettings

    def results(self) -> dict[str, Any]:
        """Return all tables, without the traces, as plain data with units in the names.

        Rows of ``tracking`` have only the numbers of their order.
        """
        parts = ("tracking", "speeds", "switching", "frequency", "bandwidth")
        tables = {part: [asdict(row) for row in getattr(self, part)] for part in parts}
        for row in (*tables["tracking"], *tables["frequency"]):
            del row["trace"]
        tables["tracking"] = [
            {name: value for name, value in row.items() if value is not None}
            for row in tables["tracking"]
        ]
        return tables

    def oscillating_n(self, direction: str) -> list[float]:
        """Return the forces in N at which the rod oscillates when it moves in ``direction``.

        ``direction`` is ``in`` or ``out``.
        """
        return [
            row.force_n for row in self.switching if row.oscillates and row.direction == direction
        ]


def switching_force_n(scenario: Scenario) -> float:
    """Return the force P_r (A_1 − A_2) in N on the rod, at which the loaded chamber changes.

    P_r is the reservoir's pressure. A_1 and A_2 are the piston areas of the two chambers.
    """
    full, oil = scenario.plant.full_order or FullCylinderParameters(), scenario.plant.cylinder
    return full.reservoir_pressure_pa * (oil.cap_area_m2 - oil.rod_side_area_m2)


def order_study(
    scenario: Scenario = UNCERTAIN_KNEE,
    settings: OrderSettings = OrderSettings(),
    **options: Unpack[SweepOptions],
) -> OrderResult:
    """Compare the two orders of the cylinder under the loads of ``settings``.

    The reference of ``scenario`` must be a sine. The full order has the scenario's valves and
    seals, or default ones. If a linearization or a bandwidth search fails, its numbers are nan and
    ``failure`` in the row has the reason. ``options``: see `kneexo.sweeps.SweepOptions`.

    Raises `ParameterError` if the reference is no sine, and the errors of failed simulations.
    """
    require_sine(scenario)
    loads, forces = settings.disturbances_n, settings.switching_forces_n
    orders_and_loads = [(order, force) for force in loads for order in ORDERS]
    speeds = [
        (order, force, flexing)
        for order, force in orders_and_loads
        if force != 0.0
        for flexing in (True, False)
    ]
    switching = [(force, flexing) for flexing in (True, False) for force in forces]
    frequency = [(*case, posture) for case in orders_and_loads for posture in settings.postures_deg]
    with open_sweep(**options) as sweep:

        def rows(
            name: str, kind: type[Row], piece: Callable[[Any], dict[str, Any]], items: Sequence[Any]
        ) -> tuple[Row, ...]:
            """Return a row of class ``kind`` for each item, made by ``piece`` as plain data."""
            made = sweep.map(piece, items, f"orders: {name}")
            return tuple(map(TypeAdapter(kind).validate_python, made))

        return OrderResult(
            tracking=rows(
                "tracking", TrackingRow, partial(tracking_row, scenario), orders_and_loads
            ),
            speeds=rows("speeds", SpeedRow, partial(speed_row, scenario, settings), speeds),
            switching=rows(
                "switching", SwitchingRow, partial(switching_row, scenario, settings), switching
            ),
            frequency=rows("frequency", FrequencyRow, partial(frequency_row, scenario), frequency),
            bandwidth=rows(
                "bandwidth", BandwidthRow, partial(bandwidth_row, scenario), orders_and_loads
            ),
            scenario=scenario,
            settings=settings,
        )
