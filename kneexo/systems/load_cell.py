"""Load cell on the rod, with offset, noise, limited range, rounding and missing readings."""

from __future__ import annotations

import math
from typing import Any

import pydrake.math as drake_math
from pydrake.systems.framework import BasicVector_

from kneexo.parameters import LoadCellParameters
from kneexo.parameters.device.torque import AS_183, TorqueParameters
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    discrete_state,
    fill,
    leaf_template,
    require_finite,
    values_of,
    where_positive,
)
from kneexo.systems.state_variable import StateVariable

_N_PER_KN = 1e3

STATE_VARIABLES = (StateVariable("filtered_force_n", _N_PER_KN),)
"""Continuous states of `LoadCell` in their order."""

_UNIFORM_DEVIATION = math.sqrt(len(AS_183) / 12.0)  # of the sum of independent uniform numbers


def next_seeds(seeds: Any) -> list[Any]:
    """Return the next states of the generators of AS 183, s ← a s mod m.

    The states are whole numbers and the products a s are below 2²⁴. So the states are exact in
    double and in single precision.
    """
    products = [a * seed for (_, a), seed in zip(AS_183, seeds, strict=True)]
    # Half a unit keeps the quotient away from whole numbers, where its rounding would decide.
    return [
        product - m * drake_math.floor((product + 0.5) / m)
        for (m, _), product in zip(AS_183, products, strict=True)
    ]


def unit_noise(seeds: Any) -> Any:
    """Return a random number of mean 0 and standard deviation 1 from the states of AS 183.

    The number is the sum of three uniform numbers, scaled. Its distribution is close to the normal
    distribution and bounded by ±3.
    """
    total = sum(seed / m for (m, _), seed in zip(AS_183, seeds, strict=True))
    return (total - 0.5 * len(AS_183)) / _UNIFORM_DEVIATION


def context_values(parameters: LoadCellParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `LoadCell`."""
    seeds = parameters.generator_seeds
    return {
        **values_of(
            parameters,
            *("range_n", "filter_s", "offset_n", "noise_n", "resolution_n"),
            *("dropout_s", "dropout_start_s"),
        ),
        **{f"seed_{index}": seed for index, seed in enumerate(seeds, 1)},
    }


class LoadCell(NamedLeaf):
    """Load cell on the rod: low-pass, offset, noise, range, quantization and missing readings.

    τ_F dz/dt = F − z,  y = q_F round(clip(z + F_off + σ n_k, ±F_max)/q_F).
    n_k is the random number of sample k (see `unit_noise`), or zero without ``seed``. The cell
    repeats its last reading for ``dropout_s``, from ``dropout_start_s`` on.

    ===============  ====  =====  =============================================================
    input port       size  unit
    ===============  ====  =====  =============================================================
    rod_force        1     N      F, positive when the rod pushes
    **output port**
    measured_force   2     N, s   reading, and the age of the reading
    ===============  ====  =====  =============================================================

    State: z in kN. The discrete state, updated every ``sample_time_s``, has the last reading, its
    age, and with ``seed`` the three states of the generator. ``Simulator.Initialize()`` sets the
    reading to the present force, and the generator to the seeds. This generator gives the same
    noise in Drake's Simulator, in compiled runs, in C and in FMUs. Drake's `RandomSource` does not
    convert to symbolic form. Context parameters by name: the numbers of `LoadCellParameters`, and
    ``seed_1`` … ``seed_3``. Source: Lee et al. 2020, Section 2, mention the load cell without its
    data.

    Parameters
    ----------
    parameters
        Numbers of the load cell.
    sample_time_s
        Time between two readings in s, by default that of the torque controller.
    initial_force_n
        z in N at the start.

    Raises
    ------
    SimulationError
        dz/dt is not finite.
    """

    def __init__(
        self,
        parameters: LoadCellParameters = LoadCellParameters(),
        sample_time_s: float = TorqueParameters().sample_time_s,
        initial_force_n: float = 0.0,
    ) -> None:
        self._declare_parameters(context_values(parameters))
        self._noisy, self._quantized = parameters.seed is not None, parameters.quantized
        self._sample_time = sample_time_s
        self._force = self.DeclareVectorInputPort("rod_force", 1)
        self.DeclareContinuousState(BasicVector_[self._scalar]([initial_force_n / _N_PER_KN]))
        self._reading = self._declare_output(
            "measured_force",
            2,
            self._read,
            self.xc_ticket(),
            self.xd_ticket(),
            self.time_ticket(),
        )
        size = 2 + len(AS_183) * self._noisy
        self._declare_update(sample_time_s, size, self._update)
        self._declare_initialization(self._initialize)

    def _initialize(self, context: Any) -> list[Any]:
        seeds = self.parameters(context)[-len(AS_183) :] if self._noisy else ()
        return [self._present(context, seeds), 0.0, *seeds]

    def _present(self, context: Any, seeds: Any) -> Any:
        """Return the reading in N. ``seeds`` are the states of the random number generator."""
        p = self.parameters(context)
        force = _N_PER_KN * context.get_continuous_state_vector().GetAtIndex(0) + p.offset_n
        if self._noisy:
            force = force + p.noise_n * unit_noise(seeds)
        force = clip(force, -p.range_n, p.range_n)
        if self._quantized:
            force = p.resolution_n * drake_math.floor(force / p.resolution_n + 0.5)
        return force

    def _read(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        last, age, *seeds = discrete_state(context)
        since = context.get_time() - p.dropout_start_s
        missing = where_positive(since, where_positive(p.dropout_s - since, 1.0, 0.0), 0.0)
        return [
            where_positive(missing, last, self._present(context, seeds)),
            where_positive(missing, age + self._sample_time, 0.0),
        ]

    def _update(self, context: Any) -> list[Any]:
        _, _, *seeds = discrete_state(context)
        return [*self._reading.Eval(context), *(next_seeds(seeds) if self._noisy else ())]

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set the rate of the low-pass. Raises `SimulationError` when the rate is not finite."""
        force = self._force.Eval(context)[0] / _N_PER_KN
        filtered = context.get_continuous_state_vector().GetAtIndex(0)
        rate = (force - filtered) / self.parameters(context).filter_s
        require_finite(self, context, force_rate=rate)
        fill(derivatives.get_mutable_vector(), [rate])


LoadCell_ = leaf_template(LoadCell)
"""Template of `LoadCell` classes by scalar type of Drake."""
