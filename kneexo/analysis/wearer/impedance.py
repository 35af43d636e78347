"""Output impedance of the knee, the torque of a wearer per rate of the knee.

`output_impedance` computes it from the linearized sampled loop. `measure_impedance` measures it
with a sine of any amplitude. Motor and pressure may then reach their limits.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from diagramc import LinearModel, linearize
from kneexo.analysis.frequency.frequency_response import require_sampled
from kneexo.analysis.frequency.sine_estimate import (
    SineEstimateSettings,
    motor_limits,
    response_uncertainty,
    settled_run,
)
from kneexo.analysis.linear.loop_equilibrium import find_equilibrium
from kneexo.analysis.linear.plant_linearization import MID_RANGE_DEG, Complex, frequency_array
from kneexo.common.plotting import BLUE, GOLD, RED, TEAL, axes_or_new, label_bode
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import LinearizationError, ParameterError
from kneexo.parameters import (
    KneeLoadParameters,
    LegParameters,
    Scenario,
    SineReference,
    TorqueParameters,
)
from kneexo.parameters.paths import changed
from kneexo.simulation import Run
from kneexo.simulation.compiled import compile_scenario, scenario_run
from kneexo.systems.knee_load import weight_torque

Port = Literal["knee", "cuff"]
"""The place of a prescribed motion: ``knee``, or ``cuff`` for the leg's side of the cuff."""

_TORQUE = "interaction_torque"
_LEG, _CUFF = "wearer:wearer_motion", f"cuff:{_TORQUE}"
ROD_STATES = ("plant/cylinder.x[0]", "plant/cylinder.x[1]")
"""Names of the states of rod position and rod velocity in the model of a closed loop."""

_RECORDS_PER_SAMPLE = 8  # the torque moves between the samples of the controller


@dataclass(frozen=True, repr=False)
class OutputImpedance(Result):
    """Output impedance Z(jω) = τ_i/(dθ/dt) of a sampled loop, for small motions.

    ``impedance`` is complex, (n,), in N·m·s/rad, at the n ``frequency_hz``. τ_i is the torque of
    the wearer on the exoskeleton, positive in flexion. θ is the angle of the knee or, for the port
    ``cuff``, of the wearer's leg. This angle is a sine, and Z belongs to the fundamental of τ_i.
    The hold and the aliases of the sampled controller are included, and other harmonics of τ_i are
    not.

    Z exists only if the loop with a prescribed motion is ``stable``. At the port ``knee`` this loop
    acts on a locked rod, where the loop gain is much larger than behind a cuff.
    """

    frequency_hz: Array
    impedance: Complex
    port: Port
    knee_angle_rad: float
    moment_arm_m: float
    stable: bool
    scenario: Scenario

    @property
    def magnitude(self) -> Array:
        """Magnitude of Z in N·m·s/rad, (n,)."""
        return np.abs(self.impedance)

    @property
    def phase_deg(self) -> Array:
        """Phase of Z in deg, −180…180, (n,). A passive port has −90…90."""
        return np.degrees(np.angle(self.impedance))

    @property
    def held_damper_n_m_s_per_rad(self) -> float:
        """Damper r²(Ā²/C_t + B), which is Z at low frequency if the motor is held.

        C_t is the leakage of pump and cylinder. Without leakage the damper is infinite.
        """
        plant = self.scenario.plant
        cylinder, leakage = plant.cylinder, plant.leakage_m3_per_s_pa
        oil = cylinder.mean_area_m2**2 / leakage if leakage > 0.0 else math.inf
        return self.moment_arm_m**2 * (oil + cylinder.damping_n_s_per_m)

    @property
    def held_spring_n_m_per_rad(self) -> float:
        """Spring r² 4 β_e Ā²/V_t of the oil, in N·m/rad.

        If the motor is held, jω Z is this spring at frequencies above the corner of the leakage.
        """
        cylinder = self.scenario.plant.cylinder
        rate = 4.0 * cylinder.bulk_modulus_pa / cylinder.total_volume_m3
        return self.moment_arm_m**2 * rate * cylinder.mean_area_m2**2

    @property
    def held_inertia_kg_m2(self) -> float:
        """Inertia r² m of the moving mass, or the inertia about the knee that the load has.

        Above the resonance with the oil's spring, Z/(jω) is this inertia.
        """
        arm = self.moment_arm_m
        return float(arm**2 * self.scenario.plant.moving_mass_kg(arm))

    @property
    def least_real_part(self) -> tuple[float, float]:
        """Least real part of Z in N·m·s/rad over the frequencies, and its frequency in Hz.

        No motion takes more energy out of a passive port than went in before. Re Z ≥ 0 at all
        frequencies below half the sampling rate is necessary for such a port. The condition is not
        sufficient, because Z leaves out the harmonics of sampling. If the least real part is
        negative, a leg with some mass or spring and little damping can begin to oscillate.
        """
        index = int(np.argmin(self.impedance.real))
        return float(self.impedance.real[index]), float(self.frequency_hz[index])

    def to_dataframe(self) -> Any:
        """Return Z as a `pandas.DataFrame` with the index ``frequency_hz``.

        The columns are ``magnitude_n_m_s_per_rad``, ``phase_deg`` and
        ``real_part_n_m_s_per_rad``. Raises `PackageError` without pandas.
        """
        columns = {
            "frequency_hz": self.frequency_hz,
            "magnitude_n_m_s_per_rad": self.magnitude,
            "phase_deg": self.phase_deg,
            "real_part_n_m_s_per_rad": self.impedance.real,
        }
        return data_frame(columns, "frequency_hz")

    def plot(self, ax: Any = None) -> Any:
        """Plot magnitude and phase of Z; return two Matplotlib axes.

        Dashed lines are the damper, spring and inertia of a held motor. The shaded phases belong to
        ports that are not passive.
        """
        caption = (
            f"Output impedance at the {self.port}, with the knee at "
            f"{math.degrees(self.knee_angle_rad):.3g}°: torque per rate of the knee. Dashed lines: "
            "asymptotes at the knee with the motor held, in reduced order. "
            "Shaded: the real part is negative, so the port is not passive."
        )
        ax = axes_or_new(ax, 2, 1, caption=caption, sharex=True, figsize=(7, 6))
        f = self.frequency_hz
        omega = 2.0 * np.pi * f
        damper, spring = self.held_damper_n_m_s_per_rad, self.held_spring_n_m_per_rad
        inertia = self.held_inertia_kg_m2
        ax[0].loglog(f, self.magnitude, BLUE, label="|Z|")
        limits = ax[0].get_ylim()
        for values, color, label in (
            (np.full_like(f, damper), TEAL, f"damper {damper:.4g} N·m·s/rad"),
            (spring / omega, GOLD, f"spring {1e-3 * spring:.4g} kN·m/rad"),
            (inertia * omega, RED, f"inertia {inertia:.3g} kg·m²"),
        ):
            ax[0].loglog(f, values, color=color, ls="--", lw=1, label=label)
        ax[0].set_ylim(limits[0], max(limits[1], 2.0 * min(damper, spring / omega[0])))
        ax[1].semilogx(f, self.phase_deg, BLUE)
        ax[1].set_ylim(-180.0, 180.0)
        for low, high in ((-180.0, -90.0), (90.0, 180.0)):
            ax[1].axhspan(low, high, color=RED, alpha=0.12, lw=0)
        label_bode(ax, "magnitude (N·m·s/rad)")
        ax[0].legend(loc="best", fontsize=8)
        return ax


def output_impedance(
    scenario: Scenario,
    frequency_hz: ArrayLike | None = None,
    *,
    knee_angle_deg: float = MID_RANGE_DEG,
    port: Port = "cuff",
    motor_held: bool = False,
) -> OutputImpedance:
    """Compute the output impedance of the sampled loop of a scenario with a wearer.

    The loop is linearized at its equilibrium with the leg at ``knee_angle_deg``. Quantizers and
    slip of the cuff are bypassed. The neutral angle of a virtual spring stays while the leg moves.
    The results hold for small motions. In full order the results hold only if the sign of the load
    does not change.

    Parameters
    ----------
    scenario
        A scenario with ``wearer.kind = leg``. The motion of its leg has no effect, and a biological
        moment is left out. So the mode ``assist`` has the impedance of ``zero_torque``.
    frequency_hz
        Frequencies in Hz, (n,). By default 200 from 0.05 Hz to 98 % of half the sampling rate.
    knee_angle_deg
        Angle of the leg in deg.
    port
        Where the motion is a sine, at the ``knee`` or at the wearer's side of the ``cuff``.
    motor_held
        True: the motor does not turn, and oil, leakage, damping, mass and cuff resist.

    Raises
    ------
    ParameterError
        The scenario has no wearer, or ``port`` is unknown.
    LinearizationError
        The loop does not rest at the angle, or a frequency is not above zero.
    """
    if port not in ("knee", "cuff"):
        raise ParameterError(f"port = {port!r}: must be knee or cuff")
    scenario = with_prescribed_leg(scenario, "output_impedance")
    # A controller without gains commands zero, and the drive holds the motor at this speed.
    held = TorqueParameters(
        sample_time_s=scenario.controller.sample_time_s,
        proportional_rad_s_per_n=0.0,
        integral_rad_s2_per_n=0.0,
        speed_feedforward=0.0,
    )
    loop = scenario.model_copy(update={"controller": held}) if motor_held else scenario
    if frequency_hz is None:
        frequency_hz = np.geomspace(0.05, 0.49 / scenario.controller.sample_time_s, 200)
    f = frequency_array(frequency_hz)
    if np.any(f <= 0.0):
        raise LinearizationError(f"frequency = {f.min():g} Hz: must be > 0")
    # Angle and rate of the leg, and a torque that adds to that of the cuff.
    model, angle = wearer_model(loop, knee_angle_deg, (_LEG, _CUFF), (_TORQUE, "moment_arm"))
    arm = float(model.operating_point.outputs[1])
    s: Complex = np.asarray(2j * np.pi * f, dtype=complex)
    if port == "cuff":
        response = model.sine_response(f)[:, 0]
        impedance = response[:, 0] / s + response[:, 1]  # of angle and rate of the leg
    else:
        model = model.prescribed(ROD_STATES)
        impedance = _at_the_knee(model.sine_response(f), s, arm)
    return OutputImpedance(f, impedance, port, angle, arm, model.stable, loop)


def with_prescribed_leg(scenario: Scenario, what: str) -> Scenario:
    """Return a scenario whose leg follows the reference, without biological moment.

    The biological moment cannot move a leg that follows the reference, and a frequency response
    does not contain it. The mode ``assist``, which needs the moment, becomes ``zero_torque``.
    Raises `ParameterError` for a scenario without a leg; the message says that ``what`` needs it.
    """
    if not isinstance(scenario.wearer, LegParameters):
        raise ParameterError(
            f"wearer.kind = {scenario.wearer.kind}: {what} needs wearer.kind = leg, with its cuff"
        )
    return _without_moment(scenario, "prescribed", {})


def torque_controller(scenario: Scenario, what: str) -> TorqueParameters:
    """Return the torque controller of a scenario.

    Raises `ParameterError` for another controller; the message says that ``what`` needs it.
    """
    law = scenario.controller
    if not isinstance(law, TorqueParameters):
        raise ParameterError(f"controller.kind = {law.kind}: {what} needs controller.kind = torque")
    return law


def posed(scenario: Scenario, knee_angle_deg: float, motion: str = "active") -> Scenario:
    """Return a scenario whose loop rests at an angle. ``motion`` is the motion of a wearer's leg.

    A constant torque carries the weight of the shank, in place of the constant torque of the load.
    Biological moments are left out as in `with_prescribed_leg`. A leg with ``active`` motion yields
    by its inertia, stiffness and damping.
    """
    changes, load = {}, scenario.plant.load
    if isinstance(load, KneeLoadParameters):
        weight = weight_torque(
            math.radians(knee_angle_deg),
            mass=load.segment_mass_kg,
            centre_of_mass=load.centre_of_mass_m,
            thigh_inclination=load.thigh_inclination_rad,
            gravity=load.gravity_m_s2,
        )
        changes["plant.load.knee_torque_n_m"] = -weight
    return _without_moment(scenario, motion, changes)


def _without_moment(scenario: Scenario, motion: str, changes: dict[str, Any]) -> Scenario:
    """Return a changed scenario without biological moment. ``motion`` is that of a wearer's leg."""
    if isinstance(scenario.wearer, LegParameters):
        changes |= {"wearer.motion": motion, "wearer.moment": None, "wearer.effort": 1.0}
    if scenario.controller.kind == "torque" and scenario.controller.mode == "assist":
        changes["controller.mode"] = "zero_torque"
    return changed(scenario, changes)


def wearer_model(
    scenario: Scenario, knee_angle_deg: float, inputs: Sequence[str], outputs: Sequence[str]
) -> tuple[LinearModel, float]:
    """Return the linear loop of a scenario with a wearer, and the angle in rad of its knee.

    The quantizers are bypassed, and the leg rests at ``knee_angle_deg``. ``inputs`` and ``outputs``
    are ports as in `diagramc.linearize`. Raises `LinearizationError` if the loop does not
    rest there.
    """
    equilibrium = find_equilibrium(scenario, knee_angle_deg=knee_angle_deg)
    with warnings.catch_warnings():
        # The age of a reading is constant, and a reading depends on time only while it is missing.
        warnings.filterwarnings("ignore", "(load_cell: .*|.* of load_cell.* depend on the time.*)")
        if not getattr(scenario.plant.load, "disturbance_amplitude_n", 0.0):
            # With an inertia, the force of the load is divided by a mass that depends on x. So the
            # derivative over x contains the load's sine, which depends on the time.
            warnings.filterwarnings("ignore", ".* of plant/cylinder.* depend on the time")
        model = linearize(
            equilibrium.equations.diagram, equilibrium.context, inputs=inputs, outputs=outputs
        )
    return model, equilibrium.knee_angle_rad


def _at_the_knee(response: Complex, s: Complex, moment_arm_m: float) -> Complex:
    """Return Z from the response of the model with prescribed rod position x and velocity v.

    A torque d adds to that of the cuff. For the rates dx/dt = v and dv/dt = s v of a sine, the
    equation of dv/dt gives d, and d gives the torque τ_i. The knee moves by −x/r.
    """
    torque, acceleration = response[:, 0], response[:, -1]
    motion = np.stack([1.0 / s, np.ones_like(s)], axis=1)  # x and v for v = 1
    missing = s - np.sum(acceleration[:, -2:] * motion, axis=1)
    added = missing / acceleration[:, 2]
    total = np.sum(torque[:, -2:] * motion, axis=1) + torque[:, 2] * added
    return np.asarray(-moment_arm_m * total, dtype=complex)


# ------------------------------------------------------------------------------ measurement


@dataclass(frozen=True, repr=False)
class MeasuredImpedance(Result):
    """Output impedance at the cuff, measured with a sine of the wearer's leg.

    ``impedance`` in N·m·s/rad is the fundamental of the interaction torque, divided by the
    fundamental of the leg's rate, and averaged over the last cycles of a run. ``uncertainty`` is
    the absolute error of ``impedance``
    (`kneexo.analysis.frequency.sine_estimate.response_uncertainty`). ``settled`` is True if each of
    these cycles agrees with the next. ``torque_amplitude_n_m`` is the amplitude of the fundamental.
    ``speed_limited_share`` is the share of the averaged time in which the motor is within 1 % of
    its speed limit.
    """

    frequency_hz: float
    amplitude_deg: float
    impedance: complex
    uncertainty: float
    settled: bool
    torque_amplitude_n_m: float
    speed_limited_share: float


def measure_impedance(
    scenario: Scenario,
    frequency_hz: float,
    amplitude_deg: float = 2.0,
    *,
    knee_angle_deg: float = MID_RANGE_DEG,
    settings: SineEstimateSettings = SineEstimateSettings(ramp_min_s=2.0),
) -> MeasuredImpedance:
    """Return the output impedance at the cuff, measured in a run with all limits of the scenario.

    The wearer's leg moves by a sine, whose amplitude grows smoothly from zero. The run is repeated
    with twice the number of cycles until the response has settled, or until the largest number of
    cycles of ``settings`` is reached, as in `kneexo.analysis.estimate_sine`. The torque is recorded
    eight times a sample of the controller, because the torque moves between the samples.

    Parameters
    ----------
    scenario
        A scenario with a wearer, and a torque controller in the mode ``zero_torque`` or
        ``assist``.
    frequency_hz
        Frequency of the sine in Hz.
    amplitude_deg
        Amplitude of the leg's angle in deg.
    knee_angle_deg
        Knee angle in deg in the middle of the sine.
    settings
        When the response counts as settled, and how long the amplitude grows.

    Raises
    ------
    ParameterError
        The scenario has no wearer, the controller follows the reference of the leg, the amplitude
        is zero, or a period has fewer than ten samples of the controller.
    SimulationError
        The run fails.
    """
    scenario = with_prescribed_leg(scenario, "measure_impedance")
    controller = scenario.controller
    if not (controller.kind == "torque" and controller.mode == "zero_torque"):
        raise ParameterError(
            "controller: follows the reference, and the leg does so too; measure_impedance needs "
            "controller.kind = torque with mode = zero_torque or assist"
        )
    if not amplitude_deg > 0.0:
        raise ParameterError(f"amplitude_deg = {amplitude_deg:g} deg: must be > 0")
    require_sampled(frequency_hz, scenario)

    def run_of(ramp_s: float, duration_s: float) -> Run:
        reference = SineReference(
            mean_deg=knee_angle_deg,
            amplitude_deg=amplitude_deg,
            frequency_hz=frequency_hz,
            ramp_s=ramp_s,
        )
        return _record(scenario, reference, duration_s)

    found = settled_run(frequency_hz, settings, run_of, output="torque", reference="angle")
    run, averaged = found.run, found.responses
    rate = 2j * math.pi * frequency_hz
    speed = run["speed"][run.time_s > run.time_s[-1] - len(averaged) / frequency_hz]
    stiffness = complex(np.mean(averaged))
    return MeasuredImpedance(
        frequency_hz=frequency_hz,
        amplitude_deg=amplitude_deg,
        impedance=stiffness / rate,
        uncertainty=response_uncertainty(averaged) / abs(rate),
        settled=found.settled,
        torque_amplitude_n_m=abs(stiffness) * math.radians(amplitude_deg),
        speed_limited_share=float(np.mean(np.abs(speed) >= 0.99 * motor_limits(scenario)[0])),
    )


def _record(scenario: Scenario, reference: SineReference, duration_s: float) -> Run:
    """Return a run with ``torque`` in N·m, ``angle`` of the leg in rad and motor ``speed``."""
    values = {"reference": reference, "simulation.duration_s": duration_s}
    scenario = changed(scenario.undisturbed(), values)
    model = compile_scenario(scenario)
    parameters, state, inputs = scenario_run(scenario, model)
    names = (_TORQUE, "wearer_motion", "motor_speed")
    result = model.simulate(
        parameters,
        state,
        duration_s,
        outputs=names,
        record_period_s=scenario.controller.sample_time_s / _RECORDS_PER_SAMPLE,
        inputs=inputs,
    )
    columns = zip(("torque", "angle", "speed"), (result[name][:, 0] for name in names), strict=True)
    return Run(result.time_s, dict(columns), scenario.simulation)
