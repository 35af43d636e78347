"""Builds the plant of motor and pump, cylinder, knee and load, as one continuous diagram."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder

from kneexo import systems
from kneexo.common.ports import input_ports
from kneexo.diagrams.part import (
    NO_FAULTS,
    Part,
    built,
    by_name,
    export_inputs,
    leaf_part,
    wire,
    with_faults,
)
from kneexo.diagrams.signals import OPTIONAL_OUTPUTS, PLANT_OUTPUTS
from kneexo.diagrams.users_part import users_part
from kneexo.errors import ParameterError
from kneexo.geometry import linkage
from kneexo.geometry.rod_inverse import RodInverse, fit_rod_inverse, rounded_rod_extension
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.law.decision import found_once
from kneexo.parameters import (
    KneeLoadParameters,
    LinkageParameters,
    PlantParameters,
    RodPolynomialParameters,
    Scenario,
    SineReference,
)
from kneexo.parameters.device.parts import (
    PartsParameters,
)
from kneexo.parameters.fields.quantity import require_object
from kneexo.parameters.fields.replaced import believed, is_replaced
from kneexo.systems import (
    bldc_pump,
    bypass_valve,
    four_bar_knee,
    full_cylinder,
    knee_load,
    knee_reference,
    motor_temperature,
    reduced_cylinder,
    torque_limited_pump,
)
from kneexo.systems.cylinder import EndStops
from kneexo.systems.four_bar_knee import knee_kinematics
from kneexo.systems.full_cylinder import holding_pressures
from kneexo.systems.knee_load import load_force

_START_RAD = math.radians(SineReference().mean_deg - SineReference().amplitude_deg)


def make_plant(
    parameters: PlantParameters = PlantParameters(),
    *,
    initial_knee_angle_rad: float = _START_RAD,
    initial_offset_m: float = 0.0,
    rod_polynomial: RodPolynomialParameters = RodPolynomialParameters(),
    fault_names: Mapping[str, tuple[str, ...]] = NO_FAULTS,
    parts: PartsParameters | Mapping[str, Any] = PartsParameters(),
    scenario: Scenario | None = None,
) -> Diagram:
    """Build the plant, motor → cylinder → knee with load, as a purely continuous diagram.

    ===============  ===================  =======================
    subsystem        leaf system          exists
    ===============  ===================  =======================
    ``motor``        `BldcPump`           without ``motor``
    ``motor``        `TorqueLimitedPump`  with ``motor``
    ``cylinder``     `ReducedCylinder`    without ``full_order``
    ``cylinder``     `FullCylinder`       with ``full_order``
    ``knee``         `FourBarKnee`        always
    ``load``         `KneeLoad`           unless the load is none
    ``temperature``  `MotorTemperature`   with ``thermal``
    ``bypass``       `BypassValve`        with ``bypass``
    ===============  ===================  =======================

    =======================  =====  ===============  ======================================
    input                    unit   exists
    =======================  =====  ===============  ======================================
    ``motor_speed_command``  rad/s  always           positive drives the rod out
    ``disturbance_force``    N      always           on the rod, positive opposes extension
    ``knee_torque``          N·m    with a load      positive flexes
    ``bypass``               1      with ``bypass``  opening of the valve, 0 to 1
    ``torque_off``           1      with ``motor``   1: no current
    ``dynamic_brake``        1      with ``motor``   1: shorted windings
    =======================  =====  ===============  ======================================

    All inputs but the command are zero if unconnected. Outputs: `PLANT_OUTPUTS`, and the
    `OPTIONAL_OUTPUTS` of the parts that the plant has.

    The plant starts at rest with zero motor speed. The chamber pressures balance load and spring,
    so that the oil does not begin to swing. In full order the lower of the two pressures equals the
    pressure of the reservoir.

    Parameters
    ----------
    parameters
        Motor, cylinder, knee, linkage and load.
    initial_knee_angle_rad
        Knee angle that defines the rod extension at the start.
    initial_offset_m
        Offset of the rod extension at the start.
    rod_polynomial
        Polynomials between knee angle and rod extension, which the plant uses if its ``rod_map`` is
        ``"polynomial"``.
    fault_names
        For subsystems by name, Context parameters that a fault can change. Such a subsystem has an
        input port for the changes, which the plant exports, such as ``motor_fault``.
    parts
        Drake systems of the user in place of ``motor``, ``cylinder`` or ``load``, by these
        names, or functions that make them: see `kneexo.parameters.device.parts.PartParameters`.
    scenario
        What such a function gets as ``scenario``.

    Raises
    ------
    ParameterError
        The start lies outside the range of motion or the stroke, or a part does not fit.
    LinkageError
        The linkage cannot be assembled.
    """
    require_object("parameters", parameters, PlantParameters, 'Scenario.preset("leg").plant')
    builder = DiagramBuilder()
    if isinstance(parts, Mapping):
        parts = PartsParameters(**parts)
    start = initial_knee_angle_rad, initial_offset_m, rod_polynomial
    of_plant = plant_parts(parameters, *start, parts, scenario)
    signals, inputs = wire(builder, with_faults(of_plant, fault_names))
    export_inputs(builder, inputs, _INPUTS | by_name(*(f"{name}_fault" for name in fault_names)))
    for name in [*plant_outputs(parameters), *further_columns(of_plant)]:
        builder.ExportOutput(signals[name], name)
    return built(builder, "plant", parts.chosen())


_INPUTS = {
    "motor_speed_command": "motor_speed_command",
    "load_force": "disturbance_force",  # without a load
    "disturbance_force": "disturbance_force",
    "knee_torque": "knee_torque",
    "torque_off": "torque_off",
    "dynamic_brake": "dynamic_brake",
    "bypass": "bypass",
}
"""By the signals that no part of the plant offers, the inputs of the plant in their order."""


def further_columns(parts: Sequence[Part]) -> dict[str, tuple[str, ...]]:
    """Return the columns of each further output of the parts of the user, by its signal."""
    return {signal: names for part in parts for signal, names in part.columns.items()}


def plant_outputs(parameters: PlantParameters) -> list[str]:
    """Return the names of the output ports of a plant, in their order."""
    names = [name for names in PLANT_OUTPUTS.values() for name in names]
    for option, (_, further) in OPTIONAL_OUTPUTS.items():
        names += further if getattr(parameters, option) is not None else ()
    return names


def scenario_plant_parts(scenario: Scenario) -> list[Part]:
    """Return the leaf systems of the plant of a scenario, with the state that it starts from."""
    if not scenario.parts.chosen():
        return plant_parts(scenario.plant, **start_arguments(scenario))
    return found_once(scenario, lambda: plant_parts(scenario.plant, **start_arguments(scenario)))


def start_arguments(scenario: Scenario) -> dict[str, Any]:
    """Return the arguments of `make_plant` that define the initial state of a scenario."""
    return {
        "initial_knee_angle_rad": knee_reference.start_angle_rad(scenario.reference),
        "initial_offset_m": scenario.initial_offset_m,
        "rod_polynomial": controller_polynomial(scenario),
        "parts": scenario.parts,
        "scenario": scenario,
    }


def plant_parts(
    parameters: PlantParameters,
    initial_knee_angle_rad: float = _START_RAD,
    initial_offset_m: float = 0.0,
    rod_polynomial: RodPolynomialParameters = RodPolynomialParameters(),
    parts: PartsParameters = PartsParameters(),
    scenario: Scenario | None = None,
) -> list[Part]:
    """Return the leaf systems of the plant; `make_plant` describes the arguments.

    The functions in a part raise `ParameterError` for a start outside the range of motion or the
    stroke, and `LinkageError` when the linkage cannot be assembled.
    """
    cylinder, full_order, load = parameters.cylinder, parameters.full_order, parameters.load
    bypass, motor, thermal = parameters.bypass, parameters.motor, parameters.thermal
    rod_map = _rod_map(parameters, rod_polynomial)
    # The pump's leakage to the reservoir acts on the chambers, also beside a pump of the user.
    external_leakage = believed(parameters.pump).external_leakage_m3_per_s_pa

    # A part has functions, because a compiled run needs values but no systems.
    def begin() -> dict[str, Any]:
        """Return what a part of the user gets as ``start``."""
        users_load = None if parts.load is None else parts.load.system(scenario, start={})
        extension, force = _start_extension_and_force(
            parameters, initial_knee_angle_rad, initial_offset_m, rod_polynomial, users_load
        )
        return _cylinder_arguments(believed(parameters), extension, force)

    def start() -> tuple[float, ...]:
        """Return the cylinder's state at rest: the chamber pressures balance load and spring."""
        extension, pressures = begin().values()
        return (extension, 0.0, *np.atleast_1d(pressures))

    def make_cylinder(**fault: Any) -> Any:
        extension, _, *pressures = start()
        stops = _end_stops(parameters, rod_polynomial)
        if full_order is None:
            return systems.ReducedCylinder(cylinder, extension, pressures[0], stops, **fault)
        return systems.FullCylinder(
            cylinder,
            full_order,
            extension,
            tuple(pressures),
            external_leakage,
            bypass,
            stops,
            **fault,
        )

    def cylinder_values() -> dict[str, float]:
        stops = _end_stops(parameters, rod_polynomial)
        if full_order is None:
            return reduced_cylinder.context_values(cylinder, stops)
        return full_cylinder.context_values(cylinder, full_order, external_leakage, bypass, stops)

    def knee_values() -> dict[str, float]:
        fit = fit_rod_inverse(parameters.linkage, rod_map)
        values = four_bar_knee.context_values(parameters.linkage, parameters.knee, fit)
        return values | _polynomial_values(fit)

    if motor is None:
        make_motor = partial(systems.BldcPump, parameters.pump, parameters.ideal_motor)
        motor_part = Part("motor", make_motor, partial(bldc_pump.context_values, parameters.pump))
    else:
        arguments = parameters.pump, motor, thermal
        motor_part = leaf_part("motor", systems.TorqueLimitedPump, torque_limited_pump, *arguments)
    cylinder_states = (reduced_cylinder if full_order is None else full_cylinder).STATE_VARIABLES
    make_knee = partial(systems.FourBarKnee, parameters.linkage, parameters.knee, rod_map)
    own = [
        motor_part._replace(states=bldc_pump.state_variables(parameters.ideal_motor)),
        Part("cylinder", make_cylinder, cylinder_values, cylinder_states, start),
        Part("knee", make_knee, knee_values),
    ]
    if isinstance(load, KneeLoadParameters) or parts.load is not None:
        own.append(leaf_part("load", systems.KneeLoad, knee_load, load))
    if thermal is not None:
        own.append(
            leaf_part(
                *("temperature", systems.MotorTemperature, motor_temperature, thermal),
                states=motor_temperature.STATE_VARIABLES,
                start=lambda: (thermal.start_degc, thermal.start_degc),
            )
        )
    if bypass is not None:
        states = bypass_valve.STATE_VARIABLES
        own.append(leaf_part("bypass", systems.BypassValve, bypass_valve, bypass, states=states))
    if users := parts.chosen():
        places = _users_places(parameters, parts, scenario)
        for index, part in enumerate(own):
            if chosen := users.get(part.name):
                template, needed = places[part.name]
                own[index] = users_part(chosen, part, template, begin(), scenario, needed=needed)
    return [part._replace(reads={"fault": f"{part.name}_fault"}) for part in own]


def _users_places(
    parameters: PlantParameters, parts: PartsParameters, scenario: Scenario | None
) -> dict[str, tuple[Callable[[], Any], tuple[str, ...]]]:
    """Return what `users_part` needs of each place: a template of its ports, and needed inputs.

    Through the needed inputs the scenario acts on the part, so that nothing of it is lost in
    silence.
    """
    motor, full_order = believed(parameters.motor), believed(parameters.full_order)
    thermal, bypass, load = parameters.thermal, parameters.bypass, believed(parameters.load)
    is_loaded = isinstance(load, KneeLoadParameters) or parts.load is not None
    is_pushed = scenario is not None and (scenario.wearer.kind != "none" or scenario.push)
    needed: dict[str, dict[str, Any]] = {
        "motor": {
            "motor_speed_command": True,
            "torque_off": motor,
            "dynamic_brake": motor,
            "motor_temperatures": thermal,
        },
        "cylinder": {
            "load_flow": True,
            "load_force": is_loaded,
            "moving_mass": getattr(load, "inertia_kg_m2", None),
            "bypass_opening": bypass,
        },
        "load": {"knee_torque": is_pushed},
    }
    templates: dict[str, Callable[[], Any]] = {
        "motor": systems.BldcPump
        if motor is None
        else partial(systems.TorqueLimitedPump, motor=motor, thermal=thermal),
        "cylinder": systems.ReducedCylinder
        if full_order is None
        else partial(systems.FullCylinder, full_order=full_order, bypass=bypass),
        "load": systems.KneeLoad,
    }
    return {
        place: (template, tuple(name for name, acts in needed[place].items() if acts))
        for place, template in templates.items()
    }


def cylinder_start(
    knee_angle_rad: float, parameters: PlantParameters = PlantParameters()
) -> dict[str, Any]:
    """Return the arguments with which a cylinder starts at rest at a knee angle.

    They are ``initial_extension_m``, and the pressures that balance load and spring:
    ``initial_pressure_pa`` of `ReducedCylinder`, or ``initial_pressures_pa`` of `FullCylinder` for
    a plant of full order.

    Raises
    ------
    ParameterError, LinkageError
        As in `make_plant`.
    """
    start = _start_extension_and_force(parameters, knee_angle_rad, 0.0, RodPolynomialParameters())
    return _cylinder_arguments(parameters, *start)


def _cylinder_arguments(
    parameters: PlantParameters, extension: float, force: float
) -> dict[str, Any]:
    """Return the arguments of a cylinder whose rod holds a force in N at an extension in m."""
    pressures = _holding_pressures_pa(parameters, force)
    if parameters.full_order is None:
        return {"initial_extension_m": extension, "initial_pressure_pa": pressures[0]}
    return {"initial_extension_m": extension, "initial_pressures_pa": pressures}


def moving_masses_kg(parameters: PlantParameters) -> tuple[float, float]:
    """Return the least and the largest mass in kg that moves with the rod in the range of motion.

    Raises `LinkageError` when the linkage cannot be assembled.
    """
    knee = parameters.knee
    angles = np.radians(np.linspace(knee.flexion_min_deg, knee.flexion_max_deg, 91))
    masses = parameters.moving_mass_kg(linkage.moment_arm(parameters.linkage, angles))
    return float(np.min(masses)), float(np.max(masses))


@lru_cache(maxsize=64)
def _polynomial_values(fit: RodInverse) -> dict[str, float]:
    """Return a dictionary of the Context parameters of `FourBarKnee` after its first vector."""
    vectors = (fit.knee_angle, fit.encoder_angle, fit.moment_arm)
    return {
        f"{group}[{i}]": value
        for group, vector in enumerate(vectors, 1)
        for i, value in enumerate(vector)
    }


def _rod_map(
    parameters: PlantParameters, rod_polynomial: RodPolynomialParameters
) -> RodPolynomialParameters | None:
    return rod_polynomial if parameters.rod_map == "polynomial" else None


@lru_cache(maxsize=64)
def _rod_extension(link: LinkageParameters, knee_angle_rad: float) -> float:
    return rounded_rod_extension(link, knee_angle_rad)


def _extension_at(
    parameters: PlantParameters, rod_polynomial: RodPolynomialParameters, knee_angle_rad: float
) -> float:
    """Return the rod extension in m at a knee angle."""
    rod_map = _rod_map(parameters, rod_polynomial)
    if rod_map is not None:
        return float(linkage.polynomial(rod_map.p_si, knee_angle_rad))
    return _rod_extension(parameters.linkage, knee_angle_rad)


def _end_stops(
    parameters: PlantParameters, rod_polynomial: RodPolynomialParameters
) -> EndStops | None:
    """Return the end stops, at the rod extensions of both ends of the range of motion."""
    stops, knee = parameters.end_stops, parameters.knee
    if stops is None:
        return None
    low, high = (
        _extension_at(parameters, rod_polynomial, math.radians(angle))
        for angle in (knee.flexion_max_deg, knee.flexion_min_deg)
    )
    return EndStops(low, high, stops.stiffness_n_per_m, stops.dissipation_s_per_m)


def _start_extension_and_force(
    parameters: PlantParameters,
    initial_knee_angle_rad: float,
    initial_offset_m: float,
    rod_polynomial: RodPolynomialParameters,
    users_load: Any = None,
) -> tuple[float, float]:
    """Return the initial rod extension in m, and the force in N of load and spring on the rod.

    A cylinder of the user has neither stroke nor spring here. ``users_load``: a load of the user.
    """
    low, high = parameters.knee.flexion_min_deg, parameters.knee.flexion_max_deg
    if not low - 1e-9 <= math.degrees(initial_knee_angle_rad) <= high + 1e-9:
        raise ParameterError(
            f"knee angle = {math.degrees(initial_knee_angle_rad):.6g} deg at the start lies "
            f"outside the range of motion {low:g} … {high:g} deg"
        )
    fit = fit_rod_inverse(parameters.linkage, _rod_map(parameters, rod_polynomial))
    # With 50 digits rounded once, so that a run starts from the same bits on every processor.
    extension = _extension_at(parameters, rod_polynomial, initial_knee_angle_rad)
    extension += initial_offset_m
    polynomials = (fit.knee_angle, fit.encoder_angle, fit.moment_arm)
    angle, _, arm = knee_kinematics(fit, polynomials, extension)
    cylinder = None if is_replaced(parameters.cylinder) else parameters.cylinder
    if cylinder and not 0.0 <= extension <= cylinder.stroke_m:
        raise ParameterError(
            f"the rod starts at {extension:.6g} m (initial offset {initial_offset_m:g} m), outside "
            f"the stroke 0 … {cylinder.stroke_m:g} m; change the start of the "
            f"reference, initial_offset_m, plant.linkage.rod_length_m or plant.cylinder.stroke_m"
        )
    slack = parameters.knee.overshoot_deg
    if initial_offset_m and not low - slack <= math.degrees(angle) <= high + slack:
        raise ParameterError(
            f"initial_offset_m = {initial_offset_m:g} m: starts at {math.degrees(angle):.3g} deg, "
            f"outside {low:g} … {high:g} deg; reduce it, or change the start of the reference"
        )
    force = cylinder.stiffness_n_per_m * extension if cylinder else 0.0
    if users_load is not None:
        context, given = users_load.CreateDefaultContext(), {"knee_angle": angle, "moment_arm": arm}
        for name, port in input_ports(users_load).items():
            port.FixValue(context, [given.get(name, 0.0)])
        force += users_load.GetOutputPort("load_force").Eval(context)[0]
    elif isinstance(parameters.load, KneeLoadParameters):
        force += load_force(parameters.load, angle, arm, 0.0)
    return extension, force


def start_rod_force(
    parameters: PlantParameters,
    initial_knee_angle_rad: float,
    initial_offset_m: float,
    rod_polynomial: RodPolynomialParameters,
) -> float:
    """Return the force of the rod on its load at the start, in N; see `make_plant`."""
    extension, force = _start_extension_and_force(
        parameters, initial_knee_angle_rad, initial_offset_m, rod_polynomial
    )
    if is_replaced(parameters.cylinder):
        return force
    return force - parameters.cylinder.stiffness_n_per_m * extension


def _holding_pressures_pa(parameters: PlantParameters, force: float) -> tuple[float, ...]:
    """Return the pressures in Pa that hold ``force`` in N.

    The result contains the load pressure P_L, or in full order the chamber pressures P_1 and P_2.
    """
    cylinder, full_order = parameters.cylinder, parameters.full_order
    if full_order is None:
        return (force / cylinder.mean_area_m2,)
    return holding_pressures(force, cylinder, full_order.reservoir_pressure_pa)
