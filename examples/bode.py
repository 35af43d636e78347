"""Linearize the sampled closed loop at a knee angle of 40°, and plot its Bode diagram."""

import matplotlib.pyplot as plt

from kneexo.analysis import linearize_loop
from kneexo.parameters import Scenario, SlidingModeParameters

loop = linearize_loop(Scenario(controller=SlidingModeParameters(lambda_per_s=40.0)), 40.0)
print(loop)
margins = loop.margins()
print(f"the phase margin is {margins.phase_margin_deg:.1f} deg")
loop.plot()
plt.savefig("bode.png")
