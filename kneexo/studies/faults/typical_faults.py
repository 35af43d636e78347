"""Faults that a designer examines first, with one or three sizes each, and their usual causes."""

from __future__ import annotations

from dataclasses import dataclass

from kneexo.parameters.paths import value_at
from kneexo.parameters.scenario import Scenario
from kneexo.parameters.task.fault import FAULTY_SIGNALS, FaultParameters, Kind


@dataclass(frozen=True)
class TypicalFault:
    """A place and a kind of fault, as in `FaultParameters`, with some sizes and the usual cause.

    The sizes of the kind ``value`` are factors of the healthy value. If the healthy value is zero
    (``healthy_is_zero``), they are the faulty values themselves.
    """

    place: str
    kind: Kind
    sizes: tuple[float, ...]
    cause: str
    healthy_is_zero: bool = False


TYPICAL_FAULTS = (
    TypicalFault("encoder", "frozen", (0.0,), "supply of the encoder lost"),
    TypicalFault("encoder", "offset", (1.0, 5.0, 20.0), "magnet or disk slipped"),
    TypicalFault("encoder", "drift", (0.5, 2.0, 10.0), "magnet creeps, counts are lost"),
    TypicalFault("encoder", "noise", (0.2, 1.0, 5.0), "shield of the cable broken"),
    TypicalFault("encoder", "dropped", (0.1, 0.5, 0.9), "loose plug"),
    TypicalFault("encoder", "late", (2.0, 5.0, 10.0), "bus of the encoder overloaded"),
    TypicalFault("encoder", "bit_flip", (5.0, 8.0, 11.0), "bit of the word disturbed"),
    TypicalFault("command", "scale", (0.5, 0.0, -1.0), "command scaled, lost or reversed"),
    TypicalFault("command", "frozen", (0.0,), "command stale, the controller hangs"),
    TypicalFault("command", "offset", (100.0, 500.0, 2000.0), "scaling of the drive wrong"),
    TypicalFault("command", "late", (2.0, 5.0, 10.0), "bus of the drive overloaded"),
    TypicalFault("load_cell", "scale", (0.5, 0.0, -1.0), "amplifier wrong or dead, wires swapped"),
    TypicalFault("load_cell", "offset", (10.0, 50.0, 200.0), "load cell overloaded"),
    TypicalFault("load_cell", "frozen", (0.0,), "converter hangs"),
    TypicalFault("plant.pump.speed_limit_rad_s", "value", (0.7, 0.4, 0.1), "speed limited"),
    TypicalFault("plant.pump.lag_s", "value", (2.0, 5.0, 20.0), "motor accelerates slowly"),
    TypicalFault("plant.motor.supply_voltage_v", "value", (0.7, 0.4, 0.1), "supply sags"),
    TypicalFault("plant.motor.current_limit_a", "value", (0.5, 0.1, 0.0), "phase lost, motor dead"),
    TypicalFault("plant.motor.coulomb_torque_n_m", "value", (5.0, 20.0, 1000.0), "shaft locked"),
    TypicalFault("plant.pump.internal_leakage_m3_per_s_pa", "value", (3.0, 10.0, 100.0), "wear"),
    TypicalFault(  # 3, 10 and 100 times the leakage of the pump
        "plant.cylinder.leakage_m3_per_s_pa", "value", (6e-13, 2e-12, 2e-11), "seal torn", True
    ),
    TypicalFault(
        "plant.full_order.entrained_air", "value", (0.01, 0.03, 0.1), "oil level too low", True
    ),
    TypicalFault("plant.full_order.coulomb_friction_n", "value", (2.0, 4.0, 8.0), "seal swollen"),
    TypicalFault(
        "plant.full_order.relief_pressure_pa", "value", (0.8, 0.5, 0.3), "relief valve weak"
    ),
    TypicalFault(
        "plant.full_order.makeup_conductance_m3_per_s_pa", "value", (0.1, 0.01, 0.0), "valve shut"
    ),
)
"""The typical faults. Sizes and causes are assumptions."""


def typical_faults(scenario: Scenario) -> dict[str, tuple[FaultParameters, ...]]:
    """Return the `TYPICAL_FAULTS` that a scenario can have, by the name of the cause.

    Each fault begins at the start of the run and is permanent.
    """
    return {
        typical.cause: tuple(
            FaultParameters(place=typical.place, kind=typical.kind, size=size * factor, start_s=0.0)
            for size in typical.sizes
        )
        for typical in TYPICAL_FAULTS
        if (factor := _factor(scenario, typical)) != 0.0
    }


def _factor(scenario: Scenario, typical: TypicalFault) -> float:
    """Return the number by which the sizes of a typical fault are multiplied in a scenario.

    The result is 0 if the scenario cannot have the fault.
    """
    if typical.place == "load_cell":
        return float(scenario.has_load_cell)
    if typical.kind == "bit_flip":
        return float(scenario.encoder.quantized)
    if typical.place in FAULTY_SIGNALS:
        return 1.0
    value = value_at(scenario, typical.place)
    if typical.healthy_is_zero:
        return float(value == 0.0)
    return float(value or 0.0)
