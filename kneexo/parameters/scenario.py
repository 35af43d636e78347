"""Parameters of one closed-loop run: `Scenario`, with the settings of its simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from kneexo.errors import ParameterError
from kneexo.parameters.device.bus import INT32_MAX, Cia402Parameters, NoBus
from kneexo.parameters.device.control import (
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    LawParameters,
    ObserverParameters,
    PidParameters,
    SlidingModeParameters,
)
from kneexo.parameters.device.law import Law
from kneexo.parameters.device.parts import (
    NUMBERS,
    PartMaker,
    PartParameters,
    PartsParameters,
)
from kneexo.parameters.device.plant import RPM, PlantParameters, RodPolynomialParameters
from kneexo.parameters.device.protection import ProtectionParameters
from kneexo.parameters.device.torque import LoadCellParameters, TorqueParameters
from kneexo.parameters.fields.fields import Words
from kneexo.parameters.fields.names import searched_for_names
from kneexo.parameters.fields.quantity import (
    Parameters,
    choice,
    optional_part,
    quantity,
    require_object,
)
from kneexo.parameters.fields.replaced import believed, is_replaced, replaced
from kneexo.parameters.presets import PRESETS, with_preset
from kneexo.parameters.task.fault import OPERATOR_INPUTS, FaultParameters
from kneexo.parameters.task.push import PushParameters
from kneexo.parameters.task.reference import (
    SHORTEST_RUN_S,
    Reference,
    SampledReference,
    SineReference,
    gait_stride_deg,
    read_reference,
    stride_frequency_hz,
    table_mapping,
)
from kneexo.parameters.wearer.wearer import (
    LegParameters,
    MomentTable,
    NoWearer,
    Wearer,
    gait_moment_stride_n_m,
)

DEFAULT_DURATION_S = 30.0
"""Duration of a run in s if neither the scenario nor a sampled reference has one: Fig. 12."""


_LEAST_TOLERANCE_OF_ROSENBROCK = 1e-12  # below, rounding errors would miss the tolerance


class SimulationParameters(Parameters):
    """Settings of a simulation. ``integrator`` selects the compiled engine or Drake's Simulator."""

    duration_s: float | None = quantity(
        None,
        "s",
        f"left out: to the last sample of a sampled, CSV or gait reference, else "
        f"{DEFAULT_DURATION_S:g} s, three periods of 0.1 Hz as in Fig. 12",
        ge=SHORTEST_RUN_S,
        le=1e5,
    )
    integrator: Literal[
        "exact_hold",
        "rk4",
        "rosenbrock",
        "radau3",
        "radau1",
        "runge_kutta3",
        "implicit_euler",
    ] = choice(
        "exact_hold",
        "exact_hold, rk4 and rosenbrock are those of the compiled engine, the others Drake's; "
        "implicit or exponential, because the hydraulic mode lies at 447 Hz",
    )
    step_s: float = quantity(
        0.002,
        "s",
        "the control period; exact_hold and rosenbrock control their error instead",
        ge=1e-7,
        le=1,
    )
    error_controlled: bool = choice(
        False, "True: Drake's integrator controls its error, and step_s is the largest step"
    )
    accuracy: float = quantity(
        1e-4, "1", "accuracy of Drake's error-controlled integrators", ge=1e-12, le=0.1
    )
    tolerance: float | None = quantity(
        None,
        "1",
        "accuracy of exact_hold and rosenbrock: local error of the states, relative to one plus "
        "the state; left out: 1e-8 for exact_hold, and 1e-7 for rosenbrock, as in exported C",
        ge=1e-14,
        le=0.01,
    )

    @model_validator(mode="after")
    def _above_rounding(self) -> SimulationParameters:
        least = _LEAST_TOLERANCE_OF_ROSENBROCK
        if self.integrator == "rosenbrock" and self.tolerance and self.tolerance < least:
            raise ValueError(
                f"tolerance = {self.tolerance:g} must be at least {least:g} for rosenbrock"
            )
        return self

    @property
    def compiled(self) -> bool:
        """True for an integrator of the compiled engine, False for one of Drake's Simulator."""
        return self.integrator in ("exact_hold", "rk4", "rosenbrock")

    def with_drake(self) -> SimulationParameters:
        """Return the settings for Drake's Simulator.

        There radau3 replaces an integrator of the compiled engine.
        """
        return self.model_copy(update={"integrator": "radau3"}) if self.compiled else self


def require_scenario(value: Any) -> None:
    """Raise `ParameterError` if the argument ``scenario`` of a function is no `Scenario`."""
    name = value if isinstance(value, str) and value in PRESETS else "leg"
    require_object("scenario", value, Scenario, f'Scenario.preset("{name}") or load_scenario(path)')


@searched_for_names
class Scenario(Parameters):
    """One closed-loop run: plant, measurement, controller, bus, reference and simulation.

    ``nominal`` is the plant that the controller is designed for, by default ``plant``.
    """

    plant: PlantParameters = PlantParameters()
    nominal: PlantParameters | None = None
    polynomial: RodPolynomialParameters | None = choice(
        None,
        "the controller's Eq. 10, 11; left out: Table 1 for the linkages G1…G5, which are "
        "identified from it, and for another linkage a fit to it, as in Fig. 5",
    )
    encoder: EncoderParameters = EncoderParameters()
    estimator: Annotated[
        ObserverParameters | DifferenceParameters | ExactParameters, Field(discriminator="kind")
    ] = ObserverParameters()
    controller: Annotated[
        SlidingModeParameters | PidParameters | TorqueParameters | LawParameters,
        Field(discriminator="kind"),
    ] = SlidingModeParameters()
    parts: PartsParameters = PartsParameters()
    load_cell: LoadCellParameters = LoadCellParameters()
    bus: Annotated[
        NoBus | Cia402Parameters,
        Field(discriminator="kind"),
        Words({"can": {"kind": "cia402"}}),
    ] = NoBus()
    reference: Reference = SineReference()
    wearer: Wearer = NoWearer()
    push: PushParameters | None = choice(
        None, "left out: nobody pushes the leg", words={False: None}
    )
    faults: tuple[FaultParameters, ...] = choice((), "left out: nothing fails")
    protection: ProtectionParameters | None = optional_part(
        "left out: no detectors, and nothing stops the motor"
    )
    initial_offset_m: float = quantity(
        0.0, "m", "rod position minus reference at the start (Fig. 9: 89 mm off)", ge=-0.15, le=0.15
    )
    simulation: SimulationParameters = SimulationParameters()

    @classmethod
    def preset(cls, name: str) -> Scenario:
        """Return the scenario ``name`` of `kneexo.parameters.presets.PRESETS`.

        ``paper`` is the default scenario. ``bench`` adds the weight of the shank and the drive on
        its bus. ``leg`` also adds the full order of the cylinder, with friction. ``wearer`` also
        adds a wearer, and controls the torque. Raises `ParameterError` for another name.

        Examples
        --------
        A preset with a heavier piston and a slower controller. The preset itself does not change.

        >>> import kneexo as kx
        >>> bench = kx.Scenario.preset("bench")
        >>> heavy = bench.changed({"plant.cylinder.mass_kg": 1.8, "controller.lambda_per_s": 10.0})
        >>> heavy.plant.cylinder.mass_kg, bench.plant.cylinder.mass_kg
        (1.8, 1.6)
        """
        return cls(**with_preset(name, {}))

    def with_engine(self, engine: Literal["compiled", "drake"] | None) -> Scenario:
        """Return the scenario with an integrator of the compiled engine or of Drake's Simulator.

        The scenario is returned unchanged if the engine is None or if the scenario already uses it.
        """
        if engine is None or (engine == "compiled") == self.simulation.compiled:
            return self
        integrator = "exact_hold" if engine == "compiled" else "radau3"
        simulation = self.simulation.model_copy(update={"integrator": integrator})
        return self.model_copy(update={"simulation": simulation})

    def with_steps(self, step_s: float) -> Scenario:
        """Return the scenario with explicit Runge–Kutta steps of fixed length ``step_s`` in s.

        The integrator is rk4 for the compiled engine, and runge_kutta3 for Drake's Simulator.
        """
        integrator = "rk4" if self.simulation.compiled else "runge_kutta3"
        steps = {"integrator": integrator, "step_s": step_s, "error_controlled": False}
        return self.model_copy(update={"simulation": self.simulation.model_copy(update=steps)})

    def with_law(
        self,
        law: Any,
        *,
        initial_state: Sequence[float] = (),
        values: Mapping[str, float] = {},
        sample_time_s: float | None = None,
    ) -> Scenario:
        """Return the scenario with a control law of the user, at the present command limit.

        `LawParameters` says what a law may read and what it must return.

        Parameters
        ----------
        law
            A function, a Drake system, a class or function that makes a Drake system, or the name
            of one of these, ``FILE.py:NAME``.
        initial_state
            First value of the argument ``state`` of the law. Empty: the default of this argument.
        values
            Values of the law's gains, by argument. A gain that is left out has its default.
        sample_time_s
            Sample time of the law in s. None: that of the present controller.

        Raises
        ------
        ParameterError
            The law cannot be used, for example because an argument has an unknown name.
        """
        states: Any = initial_state  # pydantic converts a list, an array or a number
        try:
            controller = LawParameters(
                function=Law.from_text(law) if isinstance(law, str) else law,
                initial_state=states,
                values=dict(values),
                sample_time_s=sample_time_s or self.controller.sample_time_s,
                command_limit_rad_s=self.controller.command_limit_rad_s,
            )
        except ParameterError as error:
            text = str(error).removeprefix("LawParameters: ").removeprefix("function: ")
            raise ParameterError(text) from None
        return self.model_copy(update={"controller": controller})

    def with_part(self, place: str, part: Any, *, values: Mapping[str, float] = {}) -> Scenario:
        """Return the scenario with a Drake system of the user in place of a leaf system of kneexo.

        `PartParameters` says what the system must have. The numbers of the part that it replaces,
        such as ``plant.cylinder``, stay what the controller believes of the plant. Reading them for
        anything else raises a `ParameterError`.

        Parameters
        ----------
        place
            ``cylinder``, ``motor`` (with the pump), ``load`` or ``estimator``.
        part
            A leaf system or a Diagram, a class or function that makes one, or the name
            ``FILE.py:NAME`` of one of these. None: kneexo's own part again.
        values
            Numbers of the part, by argument of the function. Left out: the defaults.

        Raises
        ------
        ParameterError
            There is no such place, or the part is none of these. What it makes is checked at its
            first use.
        """
        if place not in PartsParameters.model_fields:
            raise ParameterError(
                f"place = {place!r}: must be {', '.join(PartsParameters.model_fields)}; knee, "
                f"cuff, wearer and encoder cannot be replaced, and a law enters by with_law"
            )
        maker: Any = PartMaker.from_text(part) if isinstance(part, str) else part
        try:
            made = None if part is None else PartParameters(make=maker, values=dict(values))
        except ParameterError as error:
            text = str(error).removeprefix("PartParameters: ").removeprefix("make: ")
            raise ParameterError(text) from None
        parts = self.parts.model_copy(update={place: made})
        update = {"parts": parts, "plant": _plant_beside(parts, believed(self.plant))}
        return self.model_copy(update=update)

    def users_code(self) -> dict[str, Law]:
        """Return the law and the parts of the user, by their paths in the scenario."""
        found: dict[str, Law] = {}
        if isinstance(self.controller, LawParameters):
            found["controller.function"] = self.controller.function
        chosen = self.parts.chosen().items()
        return found | {f"parts.{place}.make": part.make for place, part in chosen}

    def with_loaded_law(self) -> Scenario:
        """Return the scenario with all gains of its law, which imports the file of the law.

        Without a law of the user the scenario itself is returned. For errors see
        `LawParameters.loaded`.
        """
        before = self.controller
        after = before.loaded() if isinstance(before, LawParameters) else before
        return self if after is before else self.model_copy(update={"controller": after})

    def undisturbed(self) -> Scenario:
        """Return the scenario for the measurement of a response.

        Nobody pushes, nothing fails, and no protection stops the motor.
        """
        return self.model_copy(update={"push": None, "faults": (), "protection": None})

    def without_quantizers(self) -> Scenario:
        """Return the scenario for linear analysis, in which no part rounds.

        Encoder, load cell and bus do not round, the load cell has no noise, the cuff does not slip,
        nobody pushes the leg, nothing fails, and no protection acts. The latency of the bus
        remains.
        """
        encoder = self.encoder.model_copy(update={"quantized": False})
        cell = self.load_cell.model_copy(update={"quantized": False, "noise_n": 0.0, "seed": None})
        bus = NoBus(latency_samples=self.bus.latency_samples)
        update: dict[str, Any] = {"encoder": encoder, "load_cell": cell, "bus": bus}
        update["plant"] = self.plant.without_temperatures()  # which would be slow states
        if isinstance(self.wearer, LegParameters):
            cuff = self.wearer.cuff.model_copy(update={"slip_torque_n_m": None})
            update["wearer"] = self.wearer.model_copy(update={"cuff": cuff})
        return self.undisturbed().model_copy(update=update)

    @property
    def duration_s(self) -> float:
        """Duration of the run in s: ``simulation.duration_s``, or a default if it is None.

        By default a run ends at the last sample of a sampled reference. With another reference the
        run lasts `DEFAULT_DURATION_S`.
        """
        if self.simulation.duration_s is not None:
            return self.simulation.duration_s
        reference = self.reference
        if isinstance(reference, SampledReference):
            return reference.times_s[-1]
        return DEFAULT_DURATION_S

    def with_duration(self) -> Scenario:
        """Return the scenario with `duration_s` as explicit value of ``simulation.duration_s``."""
        simulation = self.simulation.model_copy(update={"duration_s": self.duration_s})
        return self.model_copy(update={"simulation": simulation})

    @property
    def quantized(self) -> bool:
        """True if the encoder rounds angles to counts or the bus rounds the command."""
        return self.encoder.quantized or self.bus.velocity_unit_rad_s > 0.0

    @property
    def has_load_cell(self) -> bool:
        """True if a wearer or a torque controller needs the load cell."""
        return self.wearer.kind != "none" or self.controller.kind == "torque"

    @property
    def command_limit_rad_s(self) -> float:
        """Limit of the speed command in rad/s, the lower of the controller's and the motor's limit.

        The motor is part of the nominal plant, for which the controller is designed. An ideal motor
        has no limit. A bus that rounds lowers the limit to a whole number of its velocity units, at
        most 2³¹ − 1 units.
        """
        limit, plant = self.controller.command_limit_rad_s, self.believed_plant
        if not plant.ideal_motor:
            limit = min(limit, plant.pump.speed_limit_rad_s)
        if unit := self.bus.velocity_unit_rad_s:
            # The quotient of a whole number of units may lie just below this number.
            units = math.floor(limit / unit * (1.0 + 1e-12))
            limit = unit * min(units, INT32_MAX)
        return limit

    @property
    def pressure_rating_pa(self) -> float:
        """Rated pressure of the cylinder in Pa; infinite for a cylinder of the user."""
        cylinder = self.plant.cylinder
        return math.inf if is_replaced(cylinder) else cylinder.pressure_rating_pa

    @property
    def power_rating_w(self) -> float:
        """Rated power of the motor in W; infinite for a motor of the user."""
        return math.inf if is_replaced(self.plant.pump) else self.plant.pump.rated_power_w

    @property
    def believed_plant(self) -> PlantParameters:
        """The plant for which the controller is designed: ``nominal``, or ``plant`` without it."""
        return believed(self.plant) if self.nominal is None else self.nominal

    @model_validator(mode="after")
    def _with_replaced_numbers(self) -> Scenario:
        object.__setattr__(self, "plant", _plant_beside(self.parts, self.plant))
        return self

    @field_validator("reference", mode="wrap")
    @classmethod
    def _named_reference(cls, reference: Any, validated: Any, info: ValidationInfo) -> Any:
        reference = validated(read_reference(reference, (info.context or {}).get("directory", ".")))
        plant = info.data.get("plant")  # None if it is faulty
        if plant and isinstance(reference, SampledReference) and reference.clip:
            return reference.clipped(plant.knee.flexion_min_deg, plant.knee.flexion_max_deg)
        return reference

    @field_validator("wearer", mode="before")
    @classmethod
    def _on_the_clock_of_the_reference(cls, wearer: Any, info: ValidationInfo) -> Any:
        """Shift a file of the biological moment by ``shift_s`` of the reference.

        Both come from one recorded trial. A shift that the file of the moment has itself stays.
        """
        shift_s = getattr(info.data.get("reference"), "shift_s", 0.0)
        moment = table_mapping(wearer.get("moment")) if isinstance(wearer, dict) else None
        if shift_s and isinstance(moment, dict) and moment.get("kind") == "csv":
            return wearer | {"moment": {"shift_s": shift_s} | moment}
        return wearer

    @model_validator(mode="after")
    def _compatible(self) -> Scenario:
        sampled = isinstance(self.reference, SampledReference)
        remedy = "reduce it" + ", or set clip: true in reference: {…}" * sampled
        self.plant.knee.require_in_range(*self.reference.range_deg, remedy)
        continuous = self.controller.kind == "smc" and self.controller.continuous
        if continuous and self.estimator.kind != "exact":
            raise ValueError(
                f"controller.continuous = true needs estimator.kind = exact, "
                f"not {self.estimator.kind}"
            )
        if continuous and self.bus != NoBus():
            raise ValueError(
                f"bus.kind = {self.bus.kind} with latency_samples = {self.bus.latency_samples} "
                f"needs a discrete controller"
            )
        return self

    @model_validator(mode="after")
    def _push_fits(self) -> Scenario:
        push = self.push
        if push is None:
            return self
        if self.plant.load.kind == "none":
            raise ValueError(
                "push: plant.load.kind must be knee, on which the torque of a push acts; add "
                "plant: {load: knee}"
            )
        if self.wearer.kind != "none":
            raise ValueError(
                f"push: wearer.kind must be none, not {self.wearer.kind}; remove push or wearer"
            )
        if push.duration_s < self.controller.sample_time_s:
            raise ValueError(
                f"push.duration_s = {push.duration_s:g} s: must be >= controller.sample_time_s = "
                f"{self.controller.sample_time_s:g} s, because a push begins and ends at samples"
            )
        if push.torque_n_m and push.end_s > self.duration_s:
            raise ValueError(
                f"push ends at {push.end_s:g} s, and the run lasts {self.duration_s:g} s; must end "
                f"within the run; reduce push.start_s or push.duration_s, or extend "
                f"simulation.duration_s"
            )
        return self

    @model_validator(mode="after")
    def _faults_fit(self) -> Scenario:
        for number, fault in enumerate(self.faults):
            subject = f"faults.{number}"
            sample_time_s = self.controller.sample_time_s
            last_s = self.duration_s - sample_time_s
            if fault.start_s > last_s:
                raise ValueError(
                    f"{subject}: start_s = {fault.start_s:g} s: must be <= {last_s:g} s, the last "
                    f"sample before the end of the run; reduce start_s, or extend "
                    f"simulation.duration_s"
                )
            if fault.duration_s is not None and fault.duration_s < sample_time_s:
                raise ValueError(
                    f"{subject}: duration_s = {fault.duration_s:g} s: must be >= "
                    f"{sample_time_s:g} s, because a fault begins and ends at samples"
                )
            if fault.place == "load_cell" and not self.has_load_cell:
                raise ValueError(
                    f"{subject}: place = load_cell: needs wearer.kind = leg or controller.kind = "
                    f"torque"
                )
            if fault.place in OPERATOR_INPUTS and self.protection is None:
                raise ValueError(
                    f"{subject}: place = {fault.place}: needs protection; add protection: {{}}"
                )
            first_s = fault.size * sample_time_s
            if fault.kind == "late" and fault.start_s < first_s:
                raise ValueError(
                    f"{subject}: start_s = {fault.start_s:g} s: must be >= {first_s:g} s, because "
                    f"no sample is older"
                )
            counts = self.encoder.counts_per_revolution
            if fault.kind == "bit_flip" and not (self.encoder.quantized and 2**fault.size < counts):
                raise ValueError(
                    f"{subject}: size = {fault.size:g} of kind = bit_flip: needs "
                    f"encoder.quantized = true and a bit of {counts} counts"
                )
            for other_number, other in enumerate(self.faults[:number]):
                same = (fault.place, fault.kind) == (other.place, other.kind)
                overlap = fault.begin_s < other.end_s and other.begin_s < fault.end_s
                if same and overlap and fault.kind in ("frozen", "value"):
                    raise ValueError(
                        f"{subject}: is at the same place and time as faults.{other_number}; must "
                        f"begin after its end; set duration_s of both, or remove one"
                    )
        return self

    @model_validator(mode="after")
    def _protection_fits(self) -> Scenario:
        protection = self.protection
        if protection is None:
            return self
        if self.controller.kind == "smc" and self.controller.continuous:
            raise ValueError("protection: needs controller.continuous = false")
        missing = ""
        if protection.safe_state == "bypass" and self.plant.bypass is None:
            missing = "bypass; must be another one, or add plant: {full_order: true, bypass: true}"
        elif protection.safe_state in ("dynamic_brake", "torque_off") and self.plant.motor is None:
            missing = "motor; must be another one, or add plant: {motor: true}"
        if missing:
            safe_state = protection.safe_state
            raise ValueError(f"protection.safe_state = {safe_state}: the plant has no {missing}")
        count_deg = math.degrees(self.encoder.resolution_rad)
        sample_time_s, cell = self.controller.sample_time_s, self.load_cell
        rpm = self.bus.velocity_unit_rad_s / RPM
        knee = self.plant.knee
        travel_mm = 1e3 * self.plant.cylinder.stroke_m * count_deg
        travel_mm /= knee.flexion_max_deg - knee.flexion_min_deg
        least = {
            "range_deg": (count_deg, "deg", "one count of the encoder"),
            "rate_deg_s": (count_deg / sample_time_s, "deg/s", "one count of the encoder a sample"),
            "flow_mm": (travel_mm, "mm", "the mean travel of the rod in one count of the encoder"),
            "following_deg": (count_deg, "deg", "one count of the encoder"),
            "speed_rpm": (rpm, "rpm", "one velocity unit of the bus"),
            "load_cell_n": (3.0 * cell.noise_n, "N", "three standard deviations of the load cell"),
        }
        for name, (value, unit, what) in least.items():
            if getattr(protection, name) <= value:
                raise ValueError(
                    f"protection.{name} = {getattr(protection, name):g} {unit}: must be > "
                    f"{value:.4g} {unit}, {what}"
                )
        if self.has_load_cell and protection.load_cell_n >= cell.range_n:
            raise ValueError(
                f"protection.load_cell_n = {protection.load_cell_n:g} N: must be < "
                f"load_cell.range_n = {cell.range_n:g} N, beyond which the load cell does not read"
            )
        return self

    @model_validator(mode="after")
    def _wearer_fits(self) -> Scenario:
        leg = self.wearer
        assists = isinstance(self.controller, TorqueParameters) and self.controller.mode == "assist"
        if not isinstance(leg, LegParameters):
            if assists:
                raise ValueError("controller.mode = assist needs wearer.moment; add a wearer")
            return self
        if self.plant.load.kind == "none":
            raise ValueError(
                "wearer.kind = leg needs plant.load.kind = knee, on which the cuff acts; add "
                "plant: {load: knee}"
            )
        jump = self.reference
        if (
            leg.motion == "prescribed"
            and jump.kind == "step"
            and jump.start_deg != jump.end_deg
            and jump.time_s < self.duration_s
        ):
            raise ValueError(
                "wearer.motion = prescribed: the leg cannot follow the jump of reference.kind = "
                "step; choose reference: ramp, or wearer.motion: active"
            )
        if leg.moment is None and (assists or leg.effort != 1.0):
            why = "controller.mode = assist" if assists else f"wearer.effort = {leg.effort:g}"
            raise ValueError(
                f"{why} needs wearer.moment; add gait, a table, or the path of a CSV file with "
                f"the columns time_s and knee_moment_nm"
            )
        if leg.moment is not None:
            start_s, end_s = leg.moment.times_s[0], leg.moment.times_s[-1]
            if start_s > 0.0 or end_s < self.duration_s:
                remedies = [f"subtract {start_s:g} s from its times"] * (start_s > 0.0)
                if end_s - max(start_s, 0.0) < self.duration_s:
                    remedies.append("extend the table, or reduce simulation.duration_s")
                raise ValueError(
                    f"wearer.moment covers {start_s:g} … {end_s:g} s, and the run lasts from 0 to "
                    f"{self.duration_s:g} s; must cover it; {', and '.join(remedies)}"
                )
            self._require_one_stride(leg.moment)
        return self

    def _require_one_stride(self, moment: MomentTable) -> None:
        """Raise `ValueError` if reference and moment are of walking at different frequencies."""
        reference = self.reference
        if not isinstance(reference, SampledReference):
            return
        knee_hz = stride_frequency_hz(reference.times_s, reference.angles_deg, gait_stride_deg())
        moment_hz = stride_frequency_hz(
            moment.times_s, moment.moments_n_m, gait_moment_stride_n_m()
        )
        if abs(moment_hz - knee_hz) > 1e-6 * knee_hz:  # False for nan
            raise ValueError(
                f"wearer.moment: gait has frequency_hz = {moment_hz:.6g} Hz, must be "
                f"{knee_hz:.6g} Hz, the frequency of reference: gait"
            )


def _plant_beside(parts: PartsParameters, plant: PlantParameters) -> PlantParameters:
    """Return a plant in which the numbers that parts of the user replace cannot be read."""
    names = [name for place in parts.chosen() for name in NUMBERS.get(place, ())]
    update = {
        name: replaced(value, f"plant.{name}")
        for name in names
        if isinstance(value := getattr(plant, name), Parameters)
    }
    return plant.model_copy(update=update) if update else plant
