"""Parameters of a push, a torque that acts on the knee for a short time."""

from __future__ import annotations

from kneexo.parameters.fields.quantity import Parameters, quantity


class PushParameters(Parameters):
    """A torque pulse on the knee: somebody pushes the leg, or the leg hits an obstacle."""

    torque_n_m: float = quantity(0.0, "N·m", "assumption: none; positive flexes", ge=-500, le=500)
    start_s: float = quantity(
        10.0, "s", "assumption: after the transient of the start", ge=0, le=1e5
    )
    duration_s: float = quantity(0.2, "s", "assumption: a short knock", ge=0.001, le=1e5)

    @property
    def end_s(self) -> float:
        """Time in s at which the push ends."""
        return self.start_s + self.duration_s
