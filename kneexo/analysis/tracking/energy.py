"""Balances the energy of a run with the cylinder of full order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from diagramc import Simulation, compile_diagram
from kneexo.common.ports import input_ports
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError
from kneexo.law.decision import why_python
from kneexo.parameters import FullCylinderParameters, Scenario
from kneexo.simulation.compiled import scenario_diagram, scenario_inputs
from kneexo.systems.energy_meter import ENERGIES, EnergyMeter

SUPPLIED = ("motor_j", "reservoir_j", "wearer_j")
"""Names of the energies that flow into the actuator."""

SPENT = ("leakage_j", "valves_j", "friction_j", "load_j", "oil_j", "motion_j")
"""Names of the energies that the actuator dissipates, gives to its load or stores."""


_METERED = tuple(f"plant.{part}." for part in ("pump", "cylinder", "full_order", "load"))
"""Beginnings of the places of faults whose numbers the balance has too."""


@dataclass(frozen=True, repr=False)
class EnergyBalance(Result):
    """Result of `energy_balance`: energies since t = 0 at the times of the records.

    ``energies`` maps the names in `SUPPLIED` and `SPENT` to arrays (n,) in J. The wearer's energy
    is the work of the cuff on the exoskeleton. ``load_j`` is the work on weight, constant torque
    and disturbance. The compressed oil stores ``oil_j``. Moving mass and spring store ``motion_j``.
    """

    time_s: Array
    energies: Mapping[str, Array]

    @property
    def residual_j(self) -> Array:
        """Supplied minus spent energy in J, (n,), which is zero for an exact solution."""
        supplied = sum(self.energies[name] for name in SUPPLIED)
        return np.asarray(supplied - sum(self.energies[name] for name in SPENT))

    @property
    def throughput_j(self) -> float:
        """Largest magnitude in J that one of the energies reaches in the run."""
        return max(float(np.max(np.abs(values))) for values in self.energies.values())

    def between(self, start_s: float, end_s: float) -> dict[str, float]:
        """Return the energies in J that flow between two times, as a dictionary by name.

        The times are rounded to records. Raises `ParameterError` unless the run has both times and
        the first is earlier.
        """
        if not self.time_s[0] <= start_s < end_s <= self.time_s[-1] * (1.0 + 1e-9):
            raise ParameterError(
                f"start_s = {start_s:g} s, end_s = {end_s:g} s: must ascend within "
                f"{self.time_s[0]:g} … {self.time_s[-1]:g} s"
            )
        first, last = (int(np.argmin(np.abs(self.time_s - time))) for time in (start_s, end_s))
        return {name: float(values[last] - values[first]) for name, values in self.energies.items()}

    def to_dataframe(self) -> Any:
        """Return the energies as a `pandas.DataFrame` with the index ``time_s``.

        Raises `PackageError` without pandas.
        """
        return data_frame({"time_s": self.time_s, **self.energies}, "time_s")


def energy_balance(scenario: Scenario) -> EnergyBalance:
    """Run a scenario with the cylinder of full order, and balance its energy.

    motor + reservoir + wearer = leakage + valves + friction + load + oil + motion.

    `EnergyMeter` integrates the powers in the same run, with its step size and error control. The
    energy stored in the oil is ∫ Σ (V_i/β_e) P_i dP_i. Integration by parts gives Σ V_i P_i²/(2
    β_e) minus its initial value and minus the displaced energy of the meter. Pressures are relative
    to the atmosphere. The run uses the solver of the scenario.

    Raises
    ------
    ParameterError
        The cylinder is in reduced order, has a bypass or end stops, the oil contains air, the
        integrator is one of Drake, the law runs as Python, a push moves the knee, or a fault
        changes a number of pump, cylinder or load.
    KneexoError
        Errors of `kneexo.simulation.simulate`.
    """
    cylinder, full = scenario.plant.cylinder, _metered_cylinder(scenario)
    run = _metered_run(scenario, full)
    energies = dict(zip(ENERGIES, run["energies"].T, strict=True))
    extension, velocity = run["rod_extension"][:, 0], run["rod_velocity"][:, 0]
    cap, rod_side = run["chamber_pressures"].T
    cap_volume = full.dead_volume_m3 + cylinder.cap_area_m2 * extension
    rod_side_volume = full.dead_volume_m3 + cylinder.rod_side_area_m2 * (
        cylinder.stroke_m - extension
    )
    oil = 0.5 / cylinder.bulk_modulus_pa * (cap_volume * cap**2 + rod_side_volume * rod_side**2)
    mass = scenario.plant.moving_mass_kg(run["moment_arm"][:, 0])
    motion = 0.5 * (mass * velocity**2 + cylinder.stiffness_n_per_m * extension**2)
    energies["oil_j"] = oil - oil[0] - energies.pop("displaced_j")
    energies["motion_j"] = motion - motion[0]
    return EnergyBalance(run.time_s, {name: energies[name] for name in (*SUPPLIED, *SPENT)})


def _metered_cylinder(scenario: Scenario) -> FullCylinderParameters:
    """Return chambers and valves of a scenario whose energy can be balanced.

    Raises `ParameterError` for another scenario.
    """
    full, settings = scenario.plant.full_order, scenario.simulation
    if full is None:
        raise ParameterError("plant.full_order: is left out; must be given for an energy balance")
    for part in ("bypass", "end_stops"):
        if getattr(scenario.plant, part) is not None:
            raise ParameterError(
                f"plant.{part}: must be left out for an energy balance, which lacks its energy"
            )
    if scenario.push is not None:
        raise ParameterError("push: must be left out for an energy balance, which lacks its work")
    for number, fault in enumerate(scenario.faults):
        if fault.place.startswith(_METERED):
            raise ParameterError(
                f"faults.{number}: place = {fault.place}: must be left out for an energy balance, "
                f"which has the numbers of the healthy plant"
            )
    if full.entrained_air > 0.0:
        raise ParameterError(
            f"plant.full_order.entrained_air = {full.entrained_air:g}: must be 0 for an energy "
            f"balance, because the stored energy assumes a constant bulk modulus"
        )
    if not settings.compiled:
        raise ParameterError(
            f"simulation.integrator = {settings.integrator}: must be exact_hold, rk4 or rosenbrock "
            f"for an energy balance"
        )
    if why_python(scenario):
        raise ParameterError("controller: runs as Python; must compile for an energy balance")
    return full


def _metered_run(scenario: Scenario, full: FullCylinderParameters) -> Simulation:
    """Run the closed loop with an `EnergyMeter`; record its energies and the cylinder's state."""
    builder = DiagramBuilder()
    loop = builder.AddNamedSystem("closed_loop", scenario_diagram(scenario))
    plant = scenario.plant
    meter = builder.AddNamedSystem(
        "energy_meter", EnergyMeter(plant.pump, plant.cylinder, full, plant.load)
    )
    for name, port in input_ports(meter).items():
        if loop.HasOutputPort(name):
            builder.Connect(loop.GetOutputPort(name), port)
    inputs = [name for name in ("knee_reference", "biological_moment") if loop.HasInputPort(name)]
    for name in inputs:
        builder.ExportInput(loop.GetInputPort(name), name)
    recorded = ("rod_extension", "rod_velocity", "chamber_pressures", "moment_arm")
    for name in recorded:
        builder.ExportOutput(loop.GetOutputPort(name), name)
    builder.ExportOutput(meter.GetOutputPort("energies"), "energies")
    diagram = builder.Build()
    diagram.set_name("metered_loop")
    model, table = compile_diagram(diagram, inputs=inputs), scenario_inputs(scenario)
    parameters = model.parameters()
    settings = scenario.simulation
    return model.simulate(
        parameters,
        model.initialized(parameters, model.state(), table),
        scenario.duration_s,
        outputs=(*recorded, "energies"),
        record_period_s=scenario.controller.sample_time_s,
        inputs=table,
        integrator=settings.integrator,
        step_s=settings.step_s,
        tolerance=settings.tolerance,
    )
