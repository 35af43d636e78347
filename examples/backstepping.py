"""Your own control law in place of kneexo's: backstepping through the motor's lag, at 1 ms.

The rod moves at ẋ = g ω with g = D_m/(gear Ā), the motor at ω̇ = (u − ω)/τ. With e = x_d − x and
ω* = (ẋ_d + k₁ e)/g, the law u = ω + τ (dω*/dt + k₂ (ω* − ω) + g e) makes e and ω* − ω decay.
"""

from pydrake.math import max, min
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

import kneexo as kx
from kneexo.analysis import large_signal_bandwidth_hz
from kneexo.studies.robustness import RobustnessSettings, robustness_study, worst


@TemplateSystem.define("Backstepping_")
def Backstepping_(T):
    """The law for the scalar ``T``: float, AutoDiffXd to linearize, Expression to compile."""

    class Impl(LeafSystem_[T]):
        def _construct(self, g, tau, k_1, k_2, limit, period, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.numbers = g, tau, k_1, k_2, limit, period
            self.rod = self.DeclareVectorInputPort("rod_extension", 1)
            self.reference = self.DeclareVectorInputPort("rod_reference", 4)
            self.DeclareDiscreteState(2)  # the command, and the motor's speed by its model
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)
            held = {self.xd_ticket()}
            self.DeclareVectorOutputPort("motor_speed_command", 1, self.command, held)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, *other.numbers, converter=converter)

        def update(self, context, state):
            g, tau, k_1, k_2, limit, period = self.numbers
            command, motor = context.get_discrete_state(0).CopyToVector()
            motor += period / tau * (command - motor)
            x_d, v_d, a_d, _ = self.reference.Eval(context)
            e = x_d - self.rod.Eval(context)[0]
            wanted, rate = (v_d + k_1 * e) / g, (a_d + k_1 * (v_d - g * motor)) / g
            u = motor + tau * (rate + k_2 * (wanted - motor) + g * e)
            state.set_value(0, [max(min(u, limit), -limit), motor])

        def command(self, context, output):
            output.SetAtIndex(0, context.get_discrete_state(0)[0])

    return Impl


def make(scenario, k_1=20.0, k_2=60.0):
    """The law, tuned for the plant that the controller believes in, between our coordinates."""
    plant, controller = scenario.plant, scenario.controller
    g = plant.pump.displacement_m3_per_rad / plant.pump.gear_ratio / plant.cylinder.mean_area_m2
    limits = controller.command_limit_rad_s, controller.sample_time_s
    return Backstepping_[None](g, plant.pump.lag_s, k_1, k_2, *limits)


BACKSTEPPING = kx.Scenario().with_law(make, sample_time_s=0.001)

if __name__ == "__main__":
    print(kx.track(BACKSTEPPING).metrics)
    print(kx.linearize(BACKSTEPPING))
    print(f"-3 dB at {large_signal_bandwidth_hz(BACKSTEPPING):.3f} Hz")
    few = RobustnessSettings(samples=20, corners_max=20, sensitivity_duration_s=0, bandwidth=False)
    study = robustness_study(BACKSTEPPING, settings=few, workers=None)
    for name in ("max_error_deg", "disk_margin"):
        least_good = worst(study.samples, name)
        print(f"worst of 20 plants: {name} = {least_good.metrics[name]:.3g} at {least_good.values}")
