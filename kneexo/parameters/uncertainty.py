"""Uncertain values of a scenario, and scenarios with random values from their ranges."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from kneexo.errors import ParameterError
from kneexo.parameters.device.plant import SEAL_FRICTION_N, KneeLoadParameters, PlantParameters
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.paths import changed, has_path, known_path, value_at
from kneexo.parameters.scenario import Scenario


class Uncertainty(Parameters):
    """The range of one value of a scenario: an interval ``low`` … ``high``, or ``options``.

    An interval has the unit of its value. Random values from an interval are uniform. With
    ``scale: log`` the logarithm of the random values is uniform, which suits a value known only by
    its order of magnitude. All options are equally likely. With ``known`` the controller knows the
    value, so the controller's nominal plant changes too. ``source`` says where the range comes
    from.
    """

    low: float | None = None
    high: float | None = None
    scale: Literal["linear", "log"] = "linear"
    options: tuple[Any, ...] = ()
    known: bool = False
    source: str = "given by the user"

    @model_validator(mode="after")
    def _one_kind(self) -> Uncertainty:
        interval = self.low is not None and self.high is not None
        if interval == bool(self.options) or (self.options and self.low != self.high):
            raise ValueError("must have either low and high, or options")
        if self.low is not None and self.high is not None:
            if not self.low < self.high:
                raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")
            if self.scale == "log" and self.low <= 0.0:
                raise ValueError(f"low = {self.low:g} must be > 0 with scale: log")
        return self

    @property
    def levels(self) -> tuple[Any, ...]:
        """The two ends of the interval, or all options."""
        return self.options or (self.low, self.high)

    def at(self, share: float) -> Any:
        """Return the value at ``share`` (0 … 1) of the way from ``low`` to ``high``, or an option.

        With ``scale: log`` the way is between the logarithms. The k-th of n options belongs to the
        shares from (k − 1)/n to k/n.
        """
        if self.low is None or self.high is None:
            return self.options[min(int(share * len(self.options)), len(self.options) - 1)]
        if share in (0.0, 1.0):
            return (self.low, self.high)[int(share)]
        if self.scale == "log":
            return self.low * (self.high / self.low) ** share
        return self.low + share * (self.high - self.low)


class UncertaintySet(Parameters):
    """Uncertain values of a scenario.

    ``values`` maps a dotted path such as ``plant.cylinder.mass_kg`` to an `Uncertainty`.
    """

    values: dict[str, Uncertainty] = Field(min_length=1)

    def __repr__(self) -> str:
        """Return a short text that has only the number of uncertain values."""
        return f"UncertaintySet({len(self.values)} values)"


UNCERTAINTY = UncertaintySet(
    values={
        "plant.cylinder.mass_kg": Uncertainty(low=1.4, high=1.8, source="Table 2"),
        "plant.cylinder.bulk_modulus_pa": Uncertainty(
            low=0.2e9, high=17_200e5, scale="log", source="assumption: entrained air; Table 2"
        ),
        "plant.pump.internal_leakage_m3_per_s_pa": Uncertainty(
            low=2e-14, high=2e-12, scale="log", source="assumption: a decade about the default"
        ),
        "plant.cylinder.damping_n_s_per_m": Uncertainty(
            low=0.05, high=1000.0, source="Table 2; assumption: 40 N of seal friction at 40 mm/s"
        ),
        "plant.cylinder.bore_m": Uncertainty(
            low=19.95e-3, high=20.05e-3, source="assumption: 0.5 % of the piston areas"
        ),
        "plant.load.segment_mass_kg": Uncertainty(
            low=0.0, high=3.2, source="assumption: from no weight to twice that of Table 3"
        ),
        "plant.load.knee_torque_n_m": Uncertainty(
            low=-5.0, high=5.0, source="assumption: a wearer who helps or resists a little"
        ),
        "plant.pump.lag_s": Uncertainty(
            low=0.005, high=0.020, scale="log", source="assumption: half and twice the default"
        ),
        "plant.pump.acceleration_limit_rad_s2": Uncertainty(
            low=2e3, high=1e4, scale="log", source="assumption: as in the trials of Fig. 13"
        ),
        "encoder.mounting_error_rad": Uncertainty(
            low=-2.0 * math.pi / 4096, high=2.0 * math.pi / 4096, source="assumption: one count"
        ),
        "bus.latency_samples": Uncertainty(
            options=(0, 1, 2), source="assumption: latency of the CAN bus"
        ),
        "plant.linkage": Uncertainty(
            options=("G1", "G2", "G3"), known=True, source="three geometries reproduce Table 1"
        ),
        "plant.full_order": Uncertainty(
            options=(None, {}, {"coulomb_friction_n": SEAL_FRICTION_N}),
            source="the reduction of Eq. 14 to Eq. 15; assumption: 40 N of seal friction",
        ),
    }
)
"""Uncertain values that ``kneexo study robustness`` and ``kneexo study contest`` use by default."""

WEARER_UNCERTAINTY = UncertaintySet(
    values={
        "wearer.cuff.stiffness_n_m_per_rad": Uncertainty(
            low=750.0, high=3000.0, scale="log", source="assumption: half and twice the default"
        ),
        "load_cell.offset_n": Uncertainty(
            low=-10.0, high=10.0, source="assumption: 0.5 % of the range"
        ),
    }
)
"""Uncertain values that belong to `UNCERTAINTY` if the scenario has a wearer."""

UNCERTAIN_KNEE = Scenario(plant=PlantParameters(load=KneeLoadParameters()))
"""The scenario that `UNCERTAINTY` varies: the paper's setup under the weight of the shank."""


def applicable(
    scenario: Scenario, uncertainty: UncertaintySet
) -> tuple[UncertaintySet, tuple[str, ...]]:
    """Return the uncertain values that vary in the scenario, and the paths of the other values.

    The scenario lacks the other values. The ranges of `UNCERTAINTY` are about the paper's knee. A
    value of the scenario outside its range, such as a linkage of the user, does not vary. Options
    that the scenario refuses, such as the reduced order of a plant with a bypass, are left out.
    With a wearer `UNCERTAINTY` also has the values of `WEARER_UNCERTAINTY`.
    Raises `ParameterError` if no value is left, and the errors of `require_applicable`.
    """
    values, is_default = uncertainty.values, uncertainty == UNCERTAINTY
    if is_default and scenario.wearer.kind != "none":
        values = values | WEARER_UNCERTAINTY.values
    if is_default:
        values = {path: _accepted(value, scenario, path) for path, value in values.items()}
    present = {
        path: value
        for path, value in values.items()
        if require_applicable(scenario, path, value, values)
        and (not is_default or _includes(value, scenario, path))
    }
    if not present:
        raise ParameterError(
            f"none of the uncertain values is in this scenario: {', '.join(values)}"
        )
    return UncertaintySet(values=present), tuple(path for path in values if path not in present)


def _accepted(uncertainty: Uncertainty, scenario: Scenario, path: str) -> Uncertainty:
    """Return the uncertain value with the options that the scenario accepts, if it has any."""

    def is_accepted(option: Any) -> bool:
        try:
            changed(scenario, {path: option})
        except ParameterError:
            return False
        return True

    options = tuple(filter(is_accepted, uncertainty.options))
    return uncertainty.model_copy(update={"options": options}) if options else uncertainty


def _includes(uncertainty: Uncertainty, scenario: Scenario, path: str) -> bool:
    """Return True if the value of ``scenario`` at ``path`` is one of the uncertain values."""
    value = value_at(scenario, path)
    if uncertainty.low is not None and uncertainty.high is not None:
        return bool(uncertainty.low <= value <= uncertainty.high)
    options = (changed(scenario, {path: option}) for option in uncertainty.options)
    return any(value_at(option, path) == value for option in options)


def require_applicable(
    scenario: Scenario, path: str, uncertainty: Uncertainty, paths: Iterable[str]
) -> bool:
    """Check one uncertain value of a set. Return True if the scenario has this value.

    ``paths`` are all paths of the set. Raises `ParameterError` for a path that no scenario has, for
    a path that lies within another path of the set, for a range beyond the limits of its field, and
    for a ``known`` value outside the plant.
    """
    if within := next((other for other in paths if path.startswith(f"{other}.")), None):
        raise ParameterError(f"{path}: lies within {within}, which is uncertain too")
    if uncertainty.known and not path.startswith("plant."):
        raise ParameterError(f"{path}: known is for values of the plant")
    if not has_path(scenario, path) and known_path(path):
        return False
    for value in uncertainty.options or (uncertainty.low, uncertainty.high):
        try:
            changed(scenario, {path: value})
        except ParameterError as error:
            raise ParameterError(str(error).removeprefix("Scenario: ")) from None
    return True


def draw(uncertainty: UncertaintySet, count: int, seed: int) -> list[dict[str, Any]]:
    """Draw independent random samples of the uncertain values.

    Returns a dictionary for each sample, from dotted path to value.

    Parameters
    ----------
    uncertainty
        The uncertain values with their distributions.
    count
        Number of samples. A larger number with the same ``seed`` begins with the same samples.
    seed
        Seed of the random numbers.
    """
    entries = uncertainty.values.items()
    shares = np.random.default_rng(seed).random((count, len(entries)))
    return [
        {path: span.at(float(share)) for (path, span), share in zip(entries, row, strict=True)}
        for row in shares
    ]


def options_of(values: Mapping[str, Any]) -> str:
    """Return a text for the options in ``values``. Samples with equal texts have equal equations.

    ``values`` maps paths to values, as `draw` returns them.
    """
    return repr([(path, v) for path, v in values.items() if not isinstance(v, float)])


def realize(scenario: Scenario, uncertainty: UncertaintySet, values: Mapping[str, Any]) -> Scenario:
    """Return the scenario with one sample of its uncertain values.

    The controller keeps its nominal plant, except for the values that it knows.

    Parameters
    ----------
    scenario
        The scenario with nominal values.
    uncertainty
        The uncertain values. Those that it marks as ``known`` change the nominal plant too.
    values
        One sample of `draw`, from dotted path to value.

    Raises
    ------
    ParameterError
        The values contradict each other.
    """
    nominal = {
        f"nominal.{path.removeprefix('plant.')}": value
        for path, value in values.items()
        if uncertainty.values[path].known
    }
    changes = {**values, **nominal}
    numbers = {path: value for path, value in changes.items() if type(value) is float}
    try:
        options = json.dumps({path: changes[path] for path in changes if path not in numbers})
        return _with_options(_Same(scenario), options).changed(numbers)
    except (TypeError, ParameterError):  # not plain data, or the values contradict each other
        return changed(scenario, {"nominal": scenario.believed_plant, **changes})


class _Same:
    """A scenario that is equal to nothing but itself, because comparisons take long."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.scenario is other.scenario

    def __hash__(self) -> int:
        return id(self.scenario)


@lru_cache(maxsize=256)
def _with_options(same: _Same, options: str) -> Scenario:
    """Return the scenario with a controller that keeps its plant, and with other changes.

    ``options`` is the JSON text of the dictionary from path to value. Many samples share it.
    """
    scenario = same.scenario
    return changed(scenario, {"nominal": scenario.believed_plant, **json.loads(options)})
