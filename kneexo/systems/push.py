"""A push: a torque pulse on the knee, held from sample to sample."""

from __future__ import annotations

from typing import Any

from kneexo.parameters.task.push import PushParameters
from kneexo.systems._leaf import NamedLeaf, leaf_template, values_of, where_positive

SAME_S = 1e-9
"""Difference in s up to which a sample is at the start or at the end of the push."""


def context_values(parameters: PushParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `Push`."""
    return values_of(parameters, "torque_n_m", "start_s", "duration_s")


class Push(NamedLeaf):
    """Torque pulse on the knee: τ_k = τ_0 if t_s ≤ t_k < t_s + T_p, else 0.

    The pulse begins and ends at samples t_k, so that no integrator steps across a jump.

    ===============  ====  ====  =======================================
    **output port**  size  unit
    ===============  ====  ====  =======================================
    knee_torque      1     N·m   τ, positive flexes
    ===============  ====  ====  =======================================

    The discrete state τ_k is updated every ``sample_time_s``. Context parameters by name:
    ``torque_n_m`` (τ_0), ``start_s`` (t_s) and ``duration_s`` (T_p). Source: an assumption, Lee et
    al. 2020 push nothing.

    Parameters
    ----------
    parameters
        Size, start and duration of the pulse.
    sample_time_s
        Time between two samples in s, that of the controller.
    """

    def __init__(
        self, parameters: PushParameters = PushParameters(), sample_time_s: float = 0.002
    ) -> None:
        self._declare_parameters(context_values(parameters))
        self._declare_update(sample_time_s, 1, self._update)
        self._declare_output(
            "knee_torque",
            1,
            lambda context: [context.get_discrete_state_vector().GetAtIndex(0)],
            self.xd_ticket(),
        )

    def _update(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        since = context.get_time() - p.start_s + SAME_S
        return [where_positive(since, where_positive(p.duration_s - since, p.torque_n_m, 0.0), 0.0)]


Push_ = leaf_template(Push)
"""Template of `Push` classes by scalar type of Drake."""
