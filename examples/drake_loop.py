"""Wire the plant with a control law of your own: a step of the knee from 10° to 20°."""

import matplotlib.pyplot as plt
import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from kneexo.diagrams import make_plant


class ProportionalLaw(LeafSystem):
    """u = −K (20° − θ_p) in rad/s, every 2 ms; a positive speed of the motor extends the knee."""

    def __init__(self):
        LeafSystem.__init__(self)
        self.knee_angle = self.DeclareVectorInputPort("knee_angle", 1)
        self.DeclareStateOutputPort("command", self.DeclareDiscreteState(1))
        self.DeclarePeriodicDiscreteUpdateEvent(0.002, 0.0, self.update)

    def update(self, context, state):
        """Compute the command that holds until the next update."""
        error = np.radians(20.0) - self.knee_angle.Eval(context)
        state.set_value(0, -6000.0 * error)


builder = DiagramBuilder()
plant = builder.AddNamedSystem("plant", make_plant(initial_knee_angle_rad=np.radians(10.0)))
law = builder.AddNamedSystem("law", ProportionalLaw())
builder.Connect(plant.GetOutputPort("knee_angle"), law.GetInputPort("knee_angle"))
builder.Connect(law.GetOutputPort("command"), plant.GetInputPort("motor_speed_command"))
logger = LogVectorOutput(plant.GetOutputPort("knee_angle"), builder, publish_period=0.002)
simulator = Simulator(builder.Build())
simulator.AdvanceTo(1.0)
log = logger.FindLog(simulator.get_context())
print(f"knee angle after 1 s: {np.degrees(log.data()[0, -1]):.2f} deg")
plt.plot(log.sample_times(), np.degrees(log.data()[0]))
plt.xlabel("time (s)")
plt.ylabel("knee angle (deg)")
plt.savefig("drake_loop.png")
