"""Linearize the closed loop at a knee angle of 40°, print its margins, and plot Bode diagrams."""

import matplotlib.pyplot as plt

import kneexo as kx
from kneexo.parameters import SlidingModeParameters

scenario = kx.Scenario(controller=SlidingModeParameters(lambda_per_s=40.0))
loop = kx.linearize(scenario, knee_angle_deg=40.0)
print(loop)
print(f"the phase margin is {loop.margins().phase_margin_deg:.1f} deg")
figure, axes = plt.subplots(2, 2, sharex=True, figsize=(13, 6), layout="constrained")
loop.plot(axes[:, 0])  # the open loop, with its margins
kx.bode(scenario, knee_angle_deg=40.0).plot(axes[:, 1])  # from the reference to the knee angle
plt.savefig("bode.png")
