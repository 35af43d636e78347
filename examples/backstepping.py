"""A controller of your own in place of kneexo's: backstepping through the motor's lag, at 1 ms.

The rod moves at ẋ = g ω with g = D_m/(gear Ā), the motor at ω̇ = (u − ω)/τ. With e = x_d − x and
ω* = (ẋ_d + k₁ e)/g, the law u = ω + τ (dω*/dt + k₂ (ω* − ω) + g e) makes e and ω* − ω decay.
"""

from pydrake.systems.framework import DiagramBuilder, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from kneexo.diagrams.controller import encoder_offset_rad
from kneexo.systems import KneeCoordinates, RodReference


@TemplateSystem.define("Backstepping_")
def Backstepping_(T):
    """The law for the scalar ``T``."""

    class Impl(LeafSystem_[T]):
        def _construct(self, g, tau, k_1, k_2, limit, period, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.numbers = g, tau, k_1, k_2, limit, period
            self.rod = self.DeclareVectorInputPort("rod_extension", 1)
            self.reference = self.DeclareVectorInputPort("rod_reference", 4)
            state = self.DeclareDiscreteState(2)  # command, and what the motor does meanwhile
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)
            self.DeclareVectorOutputPort(
                "motor_speed_command", 1, self.command, {self.discrete_state_ticket(state)}
            )

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, *other.numbers, converter=converter)

        def update(self, context, state):
            g, tau, k_1, k_2, limit, period = self.numbers
            before, motor = context.get_discrete_state(0).CopyToVector()
            motor += period / tau * (before - motor)
            x_d, v_d, a_d, _ = self.reference.Eval(context)
            e = x_d - self.rod.Eval(context)[0]
            wanted, rate = (v_d + k_1 * e) / g, (a_d + k_1 * (v_d - g * motor)) / g
            u = motor + tau * (rate + k_2 * (wanted - motor) + g * e)
            state.set_value(0, [abs(u + limit) / 2 - abs(u - limit) / 2, motor])  # clipped

        def command(self, context, output):
            output.SetAtIndex(0, context.get_discrete_state(0)[0])

    return Impl


def make_controller(scenario):
    """The law between ours of reading and reference, for the plant that it believes in."""
    plant, law = scenario.plant, scenario.controller
    g = plant.pump.displacement_m3_per_rad / plant.pump.gear_ratio / plant.cylinder.mean_area_m2
    builder = DiagramBuilder()
    add = builder.AddNamedSystem
    offset = encoder_offset_rad(scenario)
    coordinates = add("coordinates", KneeCoordinates(plant.linkage, scenario.polynomial, offset))
    reference = add("rod_reference", RodReference(scenario.polynomial))
    numbers = (plant.pump.lag_s, law.values["k_1"], law.values["k_2"])
    law = Backstepping_[None](g, *numbers, law.command_limit_rad_s, law.sample_time_s)
    law = add("law", law)
    builder.Connect(coordinates.GetOutputPort("rod_extension"), law.GetInputPort("rod_extension"))
    builder.Connect(reference.get_output_port(), law.GetInputPort("rod_reference"))
    builder.ExportInput(coordinates.get_input_port(), "encoder_reading")
    builder.ExportInput(reference.get_input_port(), "knee_reference")
    builder.ExportOutput(law.get_output_port(), "motor_speed_command")
    return builder.Build()
