"""A part of the user in place of a leaf system of kneexo."""

import inspect
import math
import pickle
import re
import subprocess
import sys
from functools import partial

import numpy as np
import pydrake.math as drake_math
import pytest
import scipy
from pydrake.common.value import Value
from pydrake.systems.framework import (
    BasicVector,
    BasicVector_,
    DiagramBuilder,
    LeafSystem,
    LeafSystem_,
)
from pydrake.systems.scalar_conversion import TemplateSystem

import kneexo as kx
from kneexo import systems
from kneexo.analysis import (
    energy_balance,
    estimate_sine,
    large_signal_bandwidth_hz,
    linearize_loop,
    linearize_plant,
    stride_load,
)
from kneexo.analysis.linear.plant_linearization import plant_at
from kneexo.analysis.tracking.notices import model_notices
from kneexo.common.ports import input_ports, output_ports
from kneexo.diagrams import cylinder_start, make_closed_loop, make_plant
from kneexo.errors import CompilationError, ParameterError
from kneexo.parameters import KneeLoadParameters, Scenario
from kneexo.parameters.scenario_file import dump_scenario, load_scenario, scenario_files
from kneexo.simulation import simulate
from kneexo.simulation.compiled import users_code_key
from kneexo.simulation.engines import RunRequest, serve_runs

PAPER = Scenario().changed({"simulation.duration_s": 0.2})
LEG = Scenario.preset("leg").changed({"simulation.duration_s": 0.2})


def full_cylinder(start):
    return systems.FullCylinder(LEG.plant.cylinder, LEG.plant.full_order, **start)


@TemplateSystem.define("Rubbing_")
def Rubbing_(T):
    class Impl(LeafSystem_[T]):
        """dx/dt = v, m dv/dt = A P − B v − F_c v/√(v² + v_0²), dP/dt = 4β/V (Q − A v)."""

        parameter_names = ("coulomb_n",)

        def _construct(self, extension_m=0.1, coulomb_n=0.0, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.start = extension_m, coulomb_n
            self.flow = self.DeclareVectorInputPort("load_flow", 1)
            self.DeclareVectorInputPort("load_force", 1)
            self.DeclareNumericParameter(BasicVector_[T]([coulomb_n]))
            self.DeclareContinuousState(BasicVector_[T]([extension_m, 0.0, 0.0]))
            states = {self.all_state_ticket()}
            for name, value in {
                "rod_extension": lambda c: [self.x(c)[0]],
                "rod_velocity": lambda c: [self.x(c)[1]],
                "load_pressure": lambda c: [1e6 * self.x(c)[2]],
                "rod_force": self.force,
                "rod_state": lambda c: [self.x(c)[0], self.x(c)[1], self.force(c)[0] / 1.6],
            }.items():
                size = 3 if name == "rod_state" else 1
                self.DeclareVectorOutputPort(
                    name, size, lambda c, o, value=value: o.SetFromVector(value(c)), states
                )

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, *other.start, converter=converter)

        def x(self, context):
            return context.get_continuous_state_vector().CopyToVector()

        def force(self, context):
            _, v, p = self.x(context)
            cylinder = PAPER.plant.cylinder
            friction = context.get_numeric_parameter(0)[0] * v / (v * v + 1e-4) ** 0.5
            return [cylinder.mean_area_m2 * 1e6 * p - cylinder.damping_n_s_per_m * v - friction]

        def DoCalcTimeDerivatives(self, context, rates):
            cylinder = PAPER.plant.cylinder
            _, v, _ = self.x(context)
            flow = self.flow.Eval(context)[0] - cylinder.mean_area_m2 * v
            rate = 4e-6 * cylinder.bulk_modulus_pa / cylinder.total_volume_m3 * flow
            rates.get_mutable_vector().SetFromVector(
                [v, self.force(context)[0] / cylinder.mass_kg, rate]
            )

    return Impl


def rubbing(start, coulomb_n=20.0):
    return Rubbing_[None](start["initial_extension_m"], coulomb_n)


def within(leaf, name="inner"):
    """Return a Diagram that has a leaf system and its ports."""
    builder = DiagramBuilder()
    builder.AddNamedSystem(name, leaf) if name else builder.AddSystem(leaf)
    for port in input_ports(leaf).values():
        builder.ExportInput(port, port.get_name())
    for port in output_ports(leaf).values():
        builder.ExportOutput(port, port.get_name())
    return builder.Build()


def pump_within(lag_s=PAPER.plant.pump.lag_s, name="inner"):
    return within(systems.BldcPump(PAPER.plant.pump.model_copy(update={"lag_s": lag_s})), name)


def pump_without_name(lag_s):
    return pump_within(lag_s, "")


OWN = {
    "motor": (PAPER, systems.BldcPump),
    "motor within Diagrams": (PAPER, lambda: within(pump_within(), "between")),
    "cylinder within a Diagram": (LEG, lambda start: within(full_cylinder(start))),
    "estimator within a Diagram": (PAPER, lambda: within(systems.TrackingObserver())),
    "cylinder": (PAPER, lambda start: systems.ReducedCylinder(**start)),
    "estimator": (PAPER, systems.TrackingObserver()),
    "motor beside both chambers": (LEG, systems.BldcPump(LEG.plant.pump)),
    "load beside both chambers": (LEG, systems.KneeLoad(LEG.plant.load)),
}


@pytest.mark.parametrize("name", OWN)
def test_kneexos_own_leaf_as_a_part_gives_the_bits_of_the_run_without_it(name):
    scenario, part = OWN[name]
    expected = simulate(scenario)
    run = simulate(scenario.with_part(name.partition(" ")[0], part))
    assert run.columns.keys() == expected.columns.keys()
    for column in expected.columns:
        np.testing.assert_array_equal(run[column], expected[column])


@pytest.mark.parametrize("pump", [pump_within, pump_without_name])
def test_numbers_inside_a_diagram_of_the_user_are_those_of_the_part(pump):
    loops, runs = [], []
    for lag_s in (0.004, 0.02):  # of one structure
        own = PAPER.with_part("motor", pump, values={"lag_s": lag_s})
        expected = PAPER.changed({"plant.pump.lag_s": lag_s, "nominal": PAPER.plant})
        for scenario in (own, expected):
            loops.append(linearize_loop(scenario).eigenvalues)
            runs.append(simulate(scenario))
    for one, two in (0, 1), (2, 3):
        np.testing.assert_allclose(loops[one], loops[two], rtol=1e-12, atol=1e-12)
        for column in runs[two].columns:
            np.testing.assert_array_equal(runs[one][column], runs[two][column])
    assert np.abs(loops[0] - loops[2]).max() > 0.01


def test_both_engines_and_a_hand_wired_plant_have_the_part():
    scenario = PAPER.with_part("cylinder", rubbing, values={"coulomb_n": 30.0})
    compiled, drake = simulate(scenario), simulate(scenario.with_engine("drake"))
    np.testing.assert_allclose(compiled["knee_angle_rad"], drake["knee_angle_rad"], atol=1e-6)
    plant = make_plant(parts={"cylinder": rubbing})
    context = plant.CreateDefaultContext()
    assert plant.GetSubsystemByName("cylinder").start[1] == 20.0
    start = plant.GetOutputPort("knee_angle").Eval(context)[0]
    assert start == pytest.approx(math.radians(10.0), abs=1e-9)


@TemplateSystem.define("Slack_")
def Slack_(T):
    class Impl(LeafSystem_[T]):
        """A motor whose drive has a dead band and a lag, and a shaft with a lag of its own."""

        def _construct(self, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.command = self.DeclareVectorInputPort("motor_speed_command", 1)
            self.pressure = self.DeclareVectorInputPort("load_pressure", 1)
            self.DeclareContinuousState(2)
            self.dead_band = 3.0
            speed, pressure = {self.all_state_ticket()}, {self.pressure.ticket()}
            for name, needs in {
                "motor_speed": speed,
                "load_flow": speed | pressure,
                "shaft_torque": pressure,
                "shaft_power": speed | pressure,
                "hydraulic_power": speed | pressure,
            }.items():
                self.DeclareVectorOutputPort(name, 1, partial(self.output, name), needs)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, converter=converter)

        def output(self, name, context, output):
            pump = PAPER.plant.pump
            ratio = pump.displacement_m3_per_rad / pump.gear_ratio
            speed, _ = context.get_continuous_state_vector().CopyToVector()
            if name == "motor_speed":
                output.SetFromVector([speed])
                return
            pressure = self.pressure.Eval(context)[0]
            flow = ratio * speed - pump.leakage_m3_per_s_pa * pressure
            output[0] = {
                "load_flow": flow,
                "shaft_torque": ratio * pressure,
                "shaft_power": ratio * pressure * speed,
                "hydraulic_power": flow * pressure,
            }[name]

        def DoCalcTimeDerivatives(self, context, rates):
            speed, drive = context.get_continuous_state_vector().CopyToVector()
            command = self.command.Eval(context)[0]
            band = self.dead_band
            beyond = drake_math.max(command - band, 0.0) + drake_math.min(command + band, 0.0)
            rates.get_mutable_vector().SetFromVector(
                [(drive - speed) / 0.008, (beyond - drive) / 0.004]
            )

    return Impl


@TemplateSystem.define("Springs_")
def Springs_(T):
    class Impl(LeafSystem_[T]):
        """A spring of 4 N·m/rad around 20°, and one of 30 N·m/rad beyond 10.05°."""

        def _construct(self, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.angle = self.DeclareVectorInputPort("knee_angle", 1)
            self.arm = self.DeclareVectorInputPort("moment_arm", 1)
            needs = {self.angle.ticket(), self.arm.ticket()}
            self.DeclareVectorOutputPort("load_force", 1, self.force, needs)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, converter=converter)

        def force(self, context, output):
            angle = self.angle.Eval(context)[0]
            torque = 4.0 * (math.radians(20.0) - angle)
            torque -= 30.0 * drake_math.max(angle - math.radians(10.05), 0.0)
            output[0] = torque / self.arm.Eval(context)[0]

    return Impl


TABLE_1 = (1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0)
"""Coefficients of the rod extension in mm for the knee angle in deg, Lee et al. 2020."""

PARTS = {"cylinder": rubbing, "motor": lambda: Slack_[None](), "load": lambda: Springs_[None]()}


@pytest.mark.slow
@pytest.mark.parametrize("place", PARTS)
def test_a_part_against_an_own_integration(place):
    scenario = PAPER.with_part(place, PARTS[place])
    run = simulate(scenario.changed({"simulation.tolerance": 1e-12}))
    plant = PAPER.plant
    cylinder, pump = plant.cylinder, plant.pump
    area, stiffness = cylinder.mean_area_m2, 4 * cylinder.bulk_modulus_pa / cylinder.total_volume_m3
    ratio = pump.displacement_m3_per_rad / pump.gear_ratio
    start = run["load_pressure_pa"][0]
    state = np.array([run["rod_extension_m"][0], 0.0, start, 0.0, 0.0, run["knee_angle_rad"][0]])

    def rates(_, x, command):
        slope = 0.18 / math.pi * np.polyval(np.polyder(TABLE_1), math.degrees(x[5]))
        force = area * x[2] - cylinder.damping_n_s_per_m * x[1]
        shaft = (command - x[3]) / pump.lag_s
        drive = 0.0
        if place == "cylinder":
            force -= 20.0 * x[1] / math.sqrt(x[1] ** 2 + 1e-4)
        elif place == "motor":
            shaft = (x[4] - x[3]) / 0.008
            drive = (command - min(max(command, -3.0), 3.0) - x[4]) / 0.004
        else:
            torque = 4.0 * (math.radians(20.0) - x[5])
            force += (torque - 30.0 * max(x[5] - math.radians(10.05), 0.0)) / slope
        oil = stiffness * (ratio * x[3] - pump.leakage_m3_per_s_pa * x[2] - area * x[1])
        return [x[1], force / cylinder.mass_kg, oil, shaft, drive, x[1] / slope]

    for k, command in enumerate(run["motor_speed_command_rad_s"][1:]):
        given = (command,)
        step = scipy.integrate.solve_ivp(
            rates, (0.0, 0.002), state, "Radau", args=given, rtol=1e-11, atol=1e-13
        )
        state = step.y[:, -1]
        assert state[0] == pytest.approx(run["rod_extension_m"][k + 1], abs=1e-8)


def test_a_number_of_a_part_changes_its_linear_model_and_batches():
    loops = [
        linearize_loop(
            Scenario().with_part("cylinder", rubbing, values={"coulomb_n": force}),
            knee_angle_deg=40.0,
        )
        for force in (0.0, 20.0)
    ]
    without = linearize_loop(Scenario(), knee_angle_deg=40.0).margins()
    assert loops[0].margins().gain_margin == pytest.approx(without.gain_margin, rel=1e-12)
    assert loops[1].margins().gain_margin > 1.003 * without.gain_margin
    path = "parts.cylinder.values.coulomb_n"
    rows = kx.batch(PAPER.with_part("cylinder", rubbing), {path: [0.0, 20.0]}).rows
    peaks = [row.metrics.peak_pressure_mpa for row in rows]
    assert peaks[1] > 10.0 * peaks[0]


def test_the_numbers_of_the_replaced_part_are_the_controllers_alone():
    scenario = PAPER.with_part("cylinder", rubbing).changed({"plant.cylinder.mass_kg": 1.7})
    assert scenario.believed_plant.cylinder.mass_kg == 1.7
    copy = pickle.loads(pickle.dumps(scenario.plant))
    for plant in (scenario.plant, copy):
        assert "mass_kg=1.7" in repr(plant)
        with pytest.raises(ParameterError, match=r"^needs plant\.cylinder\.mass_kg, but a part of"):
            plant.cylinder.mass_kg  # noqa: B018
    assert scenario.with_part("cylinder", None).plant.cylinder.mass_kg == 1.7
    for function in (energy_balance, stride_load):
        leg = LEG.with_part("motor", systems.BldcPump(LEG.plant.pump))
        with pytest.raises(ParameterError, match=r"^needs plant\.pump\.\w+, but a part of yours"):
            function(leg)
    with pytest.raises(ParameterError, match=r"has no fault of its parameters; let a signal fail"):
        make_closed_loop(
            LEG.with_part("motor", systems.BldcPump).changed(
                {
                    "faults": [
                        {
                            "place": "plant.pump.lag_s",
                            "kind": "value",
                            "size": 0.02,
                            "start_s": 0.05,
                        }
                    ]
                }
            )
        )


def test_a_scenario_file_names_a_part_and_its_folder_gets_the_code(tmp_path):
    code = "from kneexo.systems import ReducedCylinder\n"
    code += "def make(start, stroke_m=0.2):\n    return ReducedCylinder(**start)\n"
    (tmp_path / "own.py").write_text(code, encoding="utf-8")
    text = "parts: {cylinder: own.py:make}\nsimulation: {duration_s: 0.1}\n"
    (tmp_path / "my.yaml").write_text(text, encoding="utf-8")
    scenario = load_scenario(tmp_path / "my.yaml")
    assert not scenario.parts.cylinder.make.is_loaded
    files = scenario_files(scenario, "scenario.yaml")
    assert files["own.py"] == code.encode()
    folder = tmp_path / "copy"
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    again = load_scenario(folder / "scenario.yaml")
    assert again == scenario
    assert dump_scenario(again) == files["scenario.yaml"]
    np.testing.assert_array_equal(simulate(again).time_s, simulate(scenario).time_s)


class AtOnce(LeafSystem):
    """A cylinder whose outputs follow its input at once, as Drake's default prerequisites say."""

    def __init__(self, values=(0.1390397,)):
        super().__init__()
        self.DeclareVectorInputPort("load_flow", 1)
        for name in ("rod_velocity", "load_pressure", "rod_force"):
            self.DeclareVectorOutputPort(name, 1, lambda context, output: None)
        self.DeclareVectorOutputPort("rod_state", 3, lambda context, output: None)
        extension = lambda context, output: output.SetFromVector(values)  # noqa: E731
        self.DeclareVectorOutputPort("rod_extension", 1, extension)


class Sampled(LeafSystem):
    def __init__(self):
        super().__init__()
        for name in ("motor_speed_command", "load_pressure"):
            self.DeclareVectorInputPort(name, 1)
        state = self.DeclareDiscreteState(1)
        for name in ("motor_speed", "load_flow", "shaft_torque", "shaft_power", "hydraulic_power"):
            self.DeclareStateOutputPort(name, state)


TWICE = systems.BldcPump()


@pytest.mark.parametrize(
    ("place", "part", "line"),
    [
        ("knee", rubbing, r"place = 'knee': must be cylinder, motor, load, estimator; knee, cuff"),
        ("cylinder", 3.0, r"part = 3: must be a function, a Drake system, or their name"),
        ("cylinder", lambda: None, r"returns NoneType; must return a Drake system"),
        ("motor", lambda: TWICE, r"returns one system twice; must make a new one at each call"),
        (
            "motor",
            systems.KneeLoad,
            r"parts\.motor: .*: has knee_angle of size 1 as input port",
        ),
        ("load", lambda mass_kg: systems.KneeLoad(), r"cannot be made: .*'mass_kg'"),
        ("motor", Sampled, r"parts\.motor: .*Sampled: has discrete states; this place must be con"),
        ("motor", lambda: make_plant(), r"has disturbance_force of size 1 as input port; input"),
        ("estimator", systems.BackwardDifference, None),
        (
            "estimator",
            lambda: systems.TrackingObserver(sample_time_s=0.004),
            "must be sampled",
        ),
        (
            "cylinder",
            Rubbing_[None](0.1),
            r"its rod starts at 0\.1 m, and the knee at 0\.13",
        ),
        ("cylinder", lambda: systems.FullCylinder(), r"its rod starts"),
        ("load", systems.KneeLoad, None),
        ("cylinder", AtOnce, r"^plant with your cylinder: .*algebraic loop.*prerequisites"),
        ("cylinder", lambda: AtOnce([1.0, 2.0]), r"has no rod_extension at the start: \w+: "),
    ],
)
def test_a_part_that_does_not_fit_is_one_line(place, part, line):
    if line is None:
        make_closed_loop(PAPER.with_part(place, part))
        return
    with pytest.raises(ParameterError, match=line) as caught:
        make_closed_loop(PAPER.with_part(place, part))
    assert "\n" not in str(caught.value)


def test_an_object_whose_copy_forgets_something_is_refused():
    motor = Slack_[None]()
    motor.dead_band = 9.0
    line = r"^parts\.motor: .*: time derivatives: the equations that were read off differ from"
    with pytest.raises(ParameterError, match=line):
        simulate(PAPER.with_part("motor", motor))


def test_a_part_that_does_not_fit_fails_alone_in_a_batch():
    def made(start, coulomb_n):
        return rubbing(start, coulomb_n) if coulomb_n < 15.0 else systems.KneeLoad()

    path = "parts.cylinder.values.coulomb_n"
    scenario = PAPER.with_part("cylinder", made, values={"coulomb_n": 0.0})
    good, bad = kx.batch(scenario, {path: [10.0, 20.0]}).rows
    assert good.metrics.max_error_deg < 1.0
    assert "has knee_angle of size 1 as input port" in bad.error
    misfit = PAPER.with_part("cylinder", systems.KneeLoad)
    answers = dict(serve_runs({0: RunRequest(misfit), 1: RunRequest(PAPER)}))
    assert isinstance(answers[0], ParameterError)
    assert answers[1].time_s.size > 2
    sampled = PAPER.with_part("estimator", systems.TrackingObserver())
    good, bad = kx.batch(sampled, {"controller.sample_time_s": [0.002, 0.004]}).rows
    assert good.metrics.max_error_deg < 1.0
    assert "must be sampled, with one update every controller.sample_time_s" in bad.error


def test_an_object_without_symbolic_form_is_refused():
    line = r"has no symbolic form \(.*; give its class, or a function that makes it$"
    with pytest.raises(ParameterError, match=line):
        simulate(PAPER.with_part("motor", Branching_[None]()))
    assert simulate(PAPER.with_part("motor", Branching_[None])).settings.integrator == "radau3"


@TemplateSystem.define("Branching_")
def Branching_(T):
    class Impl(Slack_[T]):
        """A motor that only one branch of its code moves."""

        def _construct(self, converter=None):
            Slack_[T]._construct(self, converter)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, converter)

        def DoCalcTimeDerivatives(self, context, rates):
            rate = 1.0 if self.command.Eval(context)[0] > 3.0 else 0.0
            rates.get_mutable_vector().SetFromVector([rate, 0.0])

    return Impl


@TemplateSystem.define("Proportional_")
def Proportional_(T):
    class Impl(LeafSystem_[T]):
        """A law u = K (x_d − x) + t, dt/dt = −t/s; the name of its gain has a dot."""

        parameter_names = ("law.gain",)

        def _construct(self, gain, trim=0.0, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.gain, self.trim = gain, trim
            self.DeclareContinuousState(BasicVector_[T]([trim]))
            self.wanted = self.DeclareVectorInputPort("rod_reference", 4)
            self.found = self.DeclareVectorInputPort("estimated_state", 3)
            self.DeclareNumericParameter(BasicVector_[T]([gain]))
            self.DeclareVectorOutputPort("motor_speed_command", 1, self.command)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other.gain, other.trim, converter)

        def DoCalcTimeDerivatives(self, context, rates):
            rates.get_mutable_vector().SetAtIndex(0, -context.get_continuous_state_vector()[0])

        def command(self, context, output):
            error = self.wanted.Eval(context)[0] - self.found.Eval(context)[0]
            trim = context.get_continuous_state_vector()[0]
            output.SetFromVector([context.get_numeric_parameter(0)[0] * error + trim])

    return Impl


def proportional(gain, trim=0.0):
    return lambda: Proportional_[None](gain, trim)


def test_a_system_as_law_starts_from_its_own_state():
    runs = [simulate(PAPER.with_law(proportional(0.0, t))) for t in (0.0, 30.0)]
    assert runs[0]["motor_speed_command_rad_s"][1] == 0.0
    commands = runs[1]["motor_speed_command_rad_s"][1:]
    np.testing.assert_allclose(commands, 30.0 * np.exp(-runs[1].time_s[:-1]), rtol=1e-7)


def test_a_part_that_is_made_from_limits_keeps_them_in_its_linear_loop():
    def load(mass_kg):
        return systems.KneeLoad(KneeLoadParameters(segment_mass_kg=mass_kg))

    def made(scenario):
        return load(2.0 * scenario.plant.pump.speed_limit_rad_s / limit)

    limit = PAPER.plant.pump.speed_limit_rad_s
    loops = [
        linearize_loop(PAPER.with_part("load", part)).eigenvalues
        for part in (made, lambda: load(2.0))
    ]
    np.testing.assert_allclose(loops[0], loops[1], rtol=1e-9, atol=1e-9)


def test_a_law_that_is_made_from_limits_keeps_them_in_its_linear_loop():
    limit = LEG.plant.pump.speed_limit_rad_s

    def made(scenario):
        return Proportional_[None](6000.0 * scenario.plant.pump.speed_limit_rad_s / limit)

    loops = [
        linearize_loop(LEG.with_law(law)).eigenvalues
        for law in (made, proportional(6000.0), proportional(2000.0))
    ]
    np.testing.assert_allclose(loops[0], loops[1], rtol=1e-9, atol=1e-9)
    assert np.abs(loops[1] - loops[2]).max() > 1e-3  # loops of one structure


def test_a_part_that_the_scenario_cannot_act_on_is_refused():
    loaded = PAPER.changed({"plant.load": "knee", "plant.load.inertia_kg_m2": 0.1})
    own = loaded.with_part("cylinder", rubbing)
    with pytest.raises(
        ParameterError, match=r"parts\.cylinder: .*: has no moving_mass as input po"
    ):
        simulate(own)
    typo = PAPER.with_part("cylinder", rubbing, values={"coulomb": 1.0})
    with pytest.raises(ParameterError, match=r"has no argument coulomb; did you mean coulomb_n\?"):
        simulate(typo)


def test_a_function_may_read_the_numbers_that_its_part_replaces():
    def pump(scenario):
        return systems.BldcPump(scenario.plant.pump)

    for lag_s in (0.004, 0.02):
        scenario = PAPER.changed({"plant.pump.lag_s": lag_s})
        run, own = simulate(scenario.with_part("motor", pump)), simulate(scenario)
        np.testing.assert_array_equal(run["knee_angle_rad"], own["knee_angle_rad"])


def test_a_load_of_the_user_is_balanced_at_the_start():
    load = KneeLoadParameters(segment_mass_kg=2.0)
    own = PAPER.with_part("load", lambda: systems.KneeLoad(load))
    expected = cylinder_start(math.radians(10.0), PAPER.plant.model_copy(update={"load": load}))
    pressure = simulate(own)["load_pressure_pa"][0]
    assert pressure == pytest.approx(expected["initial_pressure_pa"], rel=1e-12)
    assert re.search("a part of yours replaces load", kx.track(own).verdict.text)


class Floats(LeafSystem):
    """A motor without lag, for floats only."""

    def __init__(self):
        super().__init__()
        command = self.DeclareVectorInputPort("motor_speed_command", 1)
        self.DeclareVectorInputPort("load_pressure", 1)
        pump = PAPER.plant.pump
        for name in ("motor_speed", "load_flow", "shaft_torque", "shaft_power", "hydraulic_power"):
            gain = pump.displacement_m3_per_rad / pump.gear_ratio if name == "load_flow" else 1.0

            def scaled(context, output, gain=gain):
                output.SetFromVector(gain * command.Eval(context))

            self.DeclareVectorOutputPort(name, 1, scaled, {command.ticket()})


def test_drakes_simulator_runs_a_part_of_floats():
    scenario = PAPER.with_part("motor", Floats)
    run = simulate(scenario)
    assert run.settings.integrator == "radau3"
    ideal = PAPER.changed({"plant.ideal_motor": True}).with_engine("drake")
    np.testing.assert_allclose(
        run["knee_angle_rad"], simulate(ideal)["knee_angle_rad"], atol=math.radians(0.01)
    )
    notes = " ".join(model_notices(scenario))
    assert re.search(r"Drake's Simulator makes the runs, .*: parts\.motor: .*Floats", notes)
    assert "Simulator" not in " ".join(model_notices(PAPER.with_part("cylinder", rubbing)))
    with pytest.raises(CompilationError, match=r"motor.*: Floats does not convert to symbolic"):
        kx.compile(scenario)


def rubbing_floats(start, coulomb_n=20.0):
    """Return the cylinder `Rubbing_` without its symbolic form."""

    class RubbingFloats(LeafSystem):
        def __init__(self):
            super().__init__()
            own = self.own = rubbing(start, coulomb_n)
            self.of_own = own.CreateDefaultContext()
            self.flow = self.DeclareVectorInputPort("load_flow", 1)
            state = self.of_own.get_continuous_state_vector().CopyToVector()
            self.DeclareContinuousState(BasicVector(state))
            for index in range(own.num_output_ports()):
                port = own.get_output_port(index)

                def calc(context, output, port=port):
                    self.take(context)
                    output.SetFromVector(port.Eval(self.of_own))

                needs = {self.all_state_ticket()}
                self.DeclareVectorOutputPort(port.get_name(), port.size(), calc, needs)

        def take(self, context):
            self.of_own.SetContinuousState(context.get_continuous_state_vector().CopyToVector())

        def DoCalcTimeDerivatives(self, context, rates):
            self.take(context)
            self.own.flow.FixValue(self.of_own, self.flow.Eval(context))
            found = self.own.EvalTimeDerivatives(self.of_own)
            rates.SetFromVector(found.CopyToVector())

    return RubbingFloats()


@pytest.mark.slow(gate=1)
@pytest.mark.filterwarnings("ignore:.*central differences")
def test_a_part_of_floats_has_the_linear_models_of_its_symbolic_form():
    loops, plants = [], []
    for part in (rubbing, rubbing_floats):
        for force in (5.0, 20.0):
            scenario = Scenario().with_part("cylinder", part, values={"coulomb_n": force})
            loops.append(linearize_loop(scenario, knee_angle_deg=40.0))
            plants.append(linearize_plant(plant_at(scenario, 40.0), knee_angle_deg=40.0))
    assert abs(loops[0].margins().gain_margin - loops[1].margins().gain_margin) > 1e-3
    for exact, floats in zip(loops[:2], loops[2:], strict=True):
        np.testing.assert_allclose(floats.eigenvalues, exact.eigenvalues, rtol=1e-7, atol=1e-7)
        assert floats.margins().gain_margin == pytest.approx(exact.margins().gain_margin, rel=1e-7)
    for exact, floats in zip(plants[:2], plants[2:], strict=True):
        np.testing.assert_allclose(floats.poles, exact.poles, rtol=1e-7, atol=1e-6)


@pytest.mark.slow(gate=1)
def test_another_process_gets_a_class_that_no_file_has():
    typed_in = {"__name__": "typed_in"}
    exec(FLOATS, typed_in)
    scenario = PAPER.with_part("motor", typed_in["Floats"])
    code = (
        "import pickle, sys; from kneexo.simulation import simulate; "
        "print(repr(simulate(pickle.load(sys.stdin.buffer))['rod_extension_m'][-1].item()))"
    )
    command = [sys.executable, "-c", code]
    data = pickle.dumps(scenario)
    there = subprocess.run(command, input=data, capture_output=True, check=True).stdout
    assert float(there) == simulate(scenario)["rod_extension_m"][-1]


FLOATS = "import kneexo as kx\nfrom pydrake.systems.framework import LeafSystem\n"
FLOATS += inspect.getsource(Floats).replace("PAPER", "kx.Scenario()")


def test_a_part_of_floats_is_known_by_its_file(tmp_path):
    assert users_code_key(PAPER.with_part("motor", lambda: Floats())) is None
    keys = []
    for text in ("# one\n", "# two\n"):
        (tmp_path / "own.py").write_text(text + FLOATS, encoding="utf-8")
        scenario = PAPER.with_part("motor", f"{tmp_path / 'own.py'}:Floats")
        keys += [users_code_key(scenario) for _ in range(2)]
    assert keys[0] == keys[1] != keys[2] == keys[3]
    laws = [scenario.with_law(proportional(gain)) for gain in (1.0, 2.0)]
    keys = [*map(users_code_key, laws)]
    assert None is not keys[0] != keys[1] is not None


def test_further_outputs_of_a_part_are_signals():
    run = simulate(PAPER.with_part("cylinder", watched))
    assert [*run.columns][-3:] == ["cylinder.motor_speed", "cylinder.x[0]", "cylinder.x[1]"]
    np.testing.assert_array_equal(run["cylinder.x[0]"], run["rod_extension_m"])
    np.testing.assert_array_equal(run["cylinder.x[1]"], run["rod_velocity_m_s"])
    np.testing.assert_array_equal(run["cylinder.motor_speed"], -run["rod_extension_m"])
    own = simulate(PAPER.with_part("cylinder", rubbing))
    for column in own.columns:  # the output motor_speed is no motor's
        np.testing.assert_array_equal(run[column], own[column])
    scenario = PAPER.with_part("cylinder", watched)
    np.testing.assert_array_equal(kx.track(scenario)["cylinder.x[1]"], run["cylinder.x[1]"])
    drake = simulate(scenario.with_engine("drake"), signals=["cylinder.x"])
    assert [*drake.data] == ["cylinder.x[0]", "cylinder.x[1]"]
    np.testing.assert_allclose(drake["cylinder.x[0]"], run["cylinder.x[0]"], atol=1e-6)
    with pytest.raises(ParameterError, match=r"signal 'cylinder\.y' is unknown; .*cylinder\.x"):
        simulate(scenario, signals=["cylinder.y"])


@TemplateSystem.define("Watched_")
def Watched_(T):
    class Impl(Rubbing_[T]):
        """A cylinder with further outputs, one of which has the name of a signal of the motor."""

        def _construct(self, extension_m=0.1, coulomb_n=20.0, converter=None):
            Rubbing_[T]._construct(self, extension_m, coulomb_n, converter)
            for name, values in {
                "motor_speed": lambda c: [-self.x(c)[0]],
                "x": lambda c: self.x(c)[:2],
            }.items():
                calc = lambda c, o, values=values: o.SetFromVector(values(c))  # noqa: E731
                size = 2 if name == "x" else 1
                self.DeclareVectorOutputPort(name, size, calc, {self.all_state_ticket()})
            nothing = lambda: Value("nothing")  # noqa: E731
            self.DeclareAbstractOutputPort("text", nothing, lambda c, o: None)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, *other.start, converter=converter)

    return Impl


def watched(start):
    return Watched_[None](start["initial_extension_m"])


FUNCTIONS = {
    "track": lambda s: kx.track(s).metrics,
    "linearize": lambda s: kx.linearize(s).margins(),
    "bode": kx.bode,
    "step": lambda s: kx.step(s).step,
    "energy_balance": energy_balance,
    "stride_load": stride_load,
    "large_signal_bandwidth_hz": large_signal_bandwidth_hz,
    "estimate_sine": lambda s: estimate_sine(s).response,
    "settings": lambda s: kx.batch(s, {"controller.lambda_per_s": [12.0]}).rows[0].metrics,
}
FULL = {
    "cylinder": full_cylinder,
    "motor": systems.BldcPump(LEG.plant.pump),
    "load": systems.KneeLoad(LEG.plant.load),
    "estimator": systems.TrackingObserver(),
}


@pytest.mark.slow(gate=2)
@pytest.mark.parametrize("place", FULL)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_function_is_right_beside_a_part_or_says_which_number_it_needs(name, place):
    function, scenario = FUNCTIONS[name], LEG.with_part(place, FULL[place])
    try:
        found = repr(function(scenario))
    except ParameterError as error:
        found = str(error)
    needs = re.match(r"needs plant\.\w+\.\w+, but a part of yours replaces", found)
    assert needs or found == repr(function(LEG))
