"""Detectors of faults: residuals of encoder, motor and load cell, compared with thresholds."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import pydrake.math as drake_math

from kneexo.parameters import PlantParameters, ProtectionParameters
from kneexo.parameters.device.protection import LARGEST_THRESHOLDS
from kneexo.parameters.device.safety_states import DETECTORS
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    discrete_state,
    leaf_template,
    where_positive,
    where_within,
)

# The coordinates are replaced, not the reading before them: they stay functions of the whole number
# of counts, which the compiled engine takes from tables. Otherwise a loop with protection took 1.45
# times as long as one without.
PLAUSIBLE = ("encoder_reading", "knee_angle", "rod_extension")
"""Names of the ports whose implausible values the detectors replace."""

_TURN = 2.0 * math.pi


def context_values(
    parameters: ProtectionParameters,
    plant: PlantParameters,
    reading_range_rad: tuple[float, float],
    sample_time_s: float,
) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `FaultDetectors`."""
    area = plant.cylinder.mean_area_m2
    leakage = plant.leakage_m3_per_s_pa
    low, high = reading_range_rad
    return {
        **{
            f"{name}_threshold": detector.factor * getattr(parameters, detector.field)
            for name, detector in DETECTORS.items()
        },
        "flow_s": parameters.flow_s,
        "speed_s": parameters.speed_s,
        # In samples, because whole numbers are exact in single precision too: exported C trips at
        # the same sample.
        "trip_samples": float(max(1, round(parameters.trip_s / sample_time_s))),
        "reading_min_rad": low,
        "reading_max_rad": high,
        "travel_m_per_rad": plant.pump.displacement_m3_per_rad / (plant.pump.gear_ratio * area),
        "leakage_m_per_s_n": leakage / (area * area),
    }


class FaultDetectors(NamedLeaf):
    """Finds faults: compares six residuals of the controller's signals with thresholds.

    A residual stays below its threshold as long as knee and sensors are healthy:

    =========  =====  ============================================================
    detector   unit   residual
    =========  =====  ============================================================
    range      rad    y beyond its least or largest value
    rate       rad/s  |(y − y⁻) less whole turns|/(m T)
    flow       m      |r|, r ← (1 − T/T_f) r + x_k − x_{k−1} − T (c_ω ω − c_F F)
    load_cell  N      |F|
    speed      rad/s  |s|, s ← s + T (u − ω − s)/T_s
    following  rad    |θ_ref − θ|
    =========  =====  ============================================================

    Here y is the reading of the encoder, and y⁻ the last plausible reading, which is m samples old.
    θ and x are knee angle and rod extension at the last plausible reading, ω is the motor speed,
    u the command, and F the rod force. T is the sample time, and T_f and T_s are time constants.

    The residual r of the flow is the travel of the rod on which encoder and motor disagree. A motor
    speed ω moves the rod with c_ω ω, c_ω = D_m/(gear Ā). The leakage takes c_F F, c_F = C/Ā². The
    integral forgets an old disagreement with T_f. Without load cell F is absent, and leakage is a
    part of r.

    Counters: each detector has one, as in AUTOSAR's debouncing. In each sample the counter goes up
    by one if the residual is above the threshold, else down by one, within 0 … n. While the counter
    is n, the detector has detected a fault. So fewer than n outliers stop nothing.

    Implausible readings: a reading with range or rate above the threshold. The controller gets the
    values of the last plausible reading in its place. So neither an outlier reaches the law, nor a
    reading at which the linkage cannot be closed. The first plausible reading has no rate. Before
    it reading, angle and extension are 0, and the law does not know where the knee is. So if the
    reading at the start is implausible, ``range`` has detected a fault from the start on.

    Bad inputs: each residual is finite. A reading that is not finite, or more than a turn beyond
    its range, has no rate. Its range is a turn, the largest threshold that a user can choose. An
    input that `InputGuard` calls bad has the largest threshold of its detector as residual too. So
    no choice of a threshold hides a bad input.

    ===================  ====  =============  ====================================================
    input port           size  unit
    ===================  ====  =============  ====================================================
    encoder_reading      1     rad            y
    knee_angle           1     rad            computed from y; nan where the linkage cannot close
    rod_extension        1     m              computed from y, as the knee angle
    bad                  6     1              of `InputGuard`
    motor_speed          1     rad/s          ω as the drive reports it
    motor_speed_command  1     rad/s          u
    knee_reference       4     rad, rad/s, …  θ_ref and derivatives, only if ``follows``
    measured_force       2     N, s           F and its age, only if ``measures_force``
    **output port**
    encoder_reading      1     rad            y, or y⁻ for an implausible y
    knee_angle           1     rad            θ, that of the last plausible reading
    rod_extension        1     m              x, that of the last plausible reading
    residuals            6     rad, rad/s, …  in the order of `DETECTORS`
    detected             6     1              1 for a detector that has detected a fault, else 0
    ===================  ====  =============  ====================================================

    Discrete states, updated every ``sample_time_s``: m, which is 0 before the first plausible
    reading, y⁻, θ, x, r, s and the counters. Context parameters by name: the thresholds
    ``range_threshold``, …, ``flow_s`` (T_f), ``speed_s`` (T_s), ``trip_samples`` (n),
    ``reading_min_rad``, ``reading_max_rad``, ``travel_m_per_rad`` (c_ω) and ``leakage_m_per_s_n``
    (c_F). Source: an assumption. Lee et al. 2020 have no detectors.

    Parameters
    ----------
    parameters
        Thresholds and time constants.
    plant
        The plant that the controller assumes: pump and areas.
    reading_range_rad
        Least and largest reading of the encoder within the range of motion, in rad.
    sample_time_s
        Time T between two samples in s.
    follows
        False: the controller does not follow the reference, and the residual ``following`` is zero.
    measures_force
        False: there is no load cell, and the residual ``load_cell`` is zero.
    """

    def __init__(
        self,
        parameters: ProtectionParameters = ProtectionParameters(),
        plant: PlantParameters = PlantParameters(),
        reading_range_rad: tuple[float, float] = (-math.pi, math.pi),
        sample_time_s: float = 0.002,
        follows: bool = True,
        measures_force: bool = False,
    ) -> None:
        self._declare_parameters(
            context_values(parameters, plant, reading_range_rad, sample_time_s)
        )
        self._sample_time, self._follows = sample_time_s, follows
        self._measures_force = measures_force
        self._encoder = [self.DeclareVectorInputPort(name, 1) for name in PLAUSIBLE]
        self._bad = self.DeclareVectorInputPort("bad", len(DETECTORS))
        self._speed = self.DeclareVectorInputPort("motor_speed", 1)
        self._command = self.DeclareVectorInputPort("motor_speed_command", 1)
        sources = [self._encoder[0], self.xd_ticket()]
        others = [self._bad]
        if follows:
            self._reference = self.DeclareVectorInputPort("knee_reference", 4)
            others += [self._encoder[1], self._reference]
        if measures_force:
            self._force = self.DeclareVectorInputPort("measured_force", 2)
            others.append(self._force)
        self._declare_update(sample_time_s, 6 + len(DETECTORS), self._update)
        self._declare_initialization(self._initialize)
        self._plausible = [
            self._declare_output(name, 1, partial(self._calc_plausible, index), port, *sources)
            for index, (name, port) in enumerate(zip(PLAUSIBLE, self._encoder, strict=True))
        ]
        self._residuals = self._declare_output(
            "residuals", len(DETECTORS), self._calc_residuals, *sources, *others
        )
        self._declare_output("detected", len(DETECTORS), self._calc_detected, self.xd_ticket())

    def _encoder_residuals(self, context: Any) -> tuple[Any, Any]:
        """Return the residuals range and rate."""
        p, reading = self.parameters(context), self._encoder[0].Eval(context)[0]
        age, last, *_ = discrete_state(context)
        ends = p.reading_min_rad - _TURN, p.reading_max_rad + _TURN
        is_near = where_within(reading, *ends, 1.0, 0.0)
        reading = where_positive(is_near, reading, last)  # finite, and without a rate
        middle = 0.5 * (p.reading_min_rad + p.reading_max_rad)
        distance = drake_math.abs(_within_half_a_turn(reading - middle))
        beyond = distance - 0.5 * (p.reading_max_rad - p.reading_min_rad)
        beyond = where_positive(-beyond, 0.0, beyond)
        change = drake_math.abs(_within_half_a_turn(reading - last))
        # Over the age of the last plausible reading. Over one sample, the good reading after an
        # outlier would count as a jump.
        rate = change / (where_positive(age, age, 1.0) * self._sample_time)
        beyond = where_positive(is_near, beyond, LARGEST_THRESHOLDS["range"])
        return beyond, where_positive(age, rate, 0.0)

    def _is_plausible(self, context: Any) -> Any:
        p = self.parameters(context)
        beyond, rate = self._encoder_residuals(context)
        slow = where_positive(p.rate_threshold - rate, 1.0, 0.0)
        return where_positive(p.range_threshold - beyond, slow, 0.0)

    def _calc_plausible(self, index: int, context: Any) -> list[Any]:
        """Return reading, knee angle or rod extension, by index, or that of the last reading."""
        _, *last = discrete_state(context)
        value = self._encoder[index].Eval(context)[0]
        return [where_positive(self._is_plausible(context), value, last[index])]

    def _calc_residuals(self, context: Any) -> list[Any]:
        _, _, _, _, travel, speed, *_ = discrete_state(context)
        force = self._force.Eval(context)[0] if self._measures_force else 0.0
        following = 0.0
        if self._follows:
            following = self._reference.Eval(context)[0] - self._plausible[1].Eval(context)[0]
        others = (drake_math.abs(value) for value in (travel, force, speed, following))
        residuals = [*self._encoder_residuals(context), *others]
        numbers = zip(self._bad.Eval(context), LARGEST_THRESHOLDS.values(), residuals, strict=True)
        return [where_positive(*row) for row in numbers]

    def _calc_detected(self, context: Any) -> list[Any]:
        n = self.parameters(context).trip_samples
        counts = discrete_state(context)[-len(DETECTORS) :]
        # Counters are whole numbers, so half a count cannot decide otherwise by rounding.
        return [where_positive(count - n + 0.5, 1.0, 0.0) for count in counts]

    def _initialize(self, context: Any) -> list[Any]:
        n = self.parameters(context).trip_samples
        missing = where_positive(self._is_plausible(context), 0.0, n)
        return [0.0] * 6 + [missing if name == "range" else 0.0 for name in DETECTORS]

    def _update(self, context: Any) -> list[Any]:
        p, dt = self.parameters(context), self._sample_time
        age, _, _, before, travel, slip, *counts = discrete_state(context)
        reading, angle, extension = (port.Eval(context)[0] for port in self._plausible)
        speed = self._speed.Eval(context)[0]
        by_motor = p.travel_m_per_rad * speed
        if self._measures_force:
            by_motor = by_motor - p.leakage_m_per_s_n * self._force.Eval(context)[0]
        moved = where_positive(age, extension - before, 0.0)
        travel = travel - dt / p.flow_s * travel + moved - dt * by_motor
        slip = slip + dt / p.speed_s * (self._command.Eval(context)[0] - speed - slip)
        # The thresholds are the first parameters.
        for index, residual in enumerate(self._residuals.Eval(context)):
            step = where_positive(p[index] - residual, -1.0, 1.0)
            counts[index] = clip(counts[index] + step, 0.0, p.trip_samples)
        older = where_positive(age, age + 1.0, 0.0)  # there is no age before a plausible reading
        age = where_positive(self._is_plausible(context), 1.0, older)
        return [age, reading, angle, extension, travel, slip, *counts]


def _within_half_a_turn(angle: Any) -> Any:
    """Return an angle in rad less whole turns, within ±π."""
    return angle - _TURN * drake_math.floor((1.0 / _TURN) * angle + 0.5)


FaultDetectors_ = leaf_template(FaultDetectors)
"""Template of `FaultDetectors` classes by scalar type of Drake."""
