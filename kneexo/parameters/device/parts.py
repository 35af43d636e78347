"""Parts of the user: Drake systems in place of leaf systems of plant and controller."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from pydantic import field_validator

from kneexo.common.user_code import user_code
from kneexo.errors import ParameterError, close_names, question
from kneexo.parameters.device.law import Law
from kneexo.parameters.fields.quantity import Parameters, choice


class PartMaker(Law):
    """A Drake system of the user, or a class or function that makes one.

    A function may have the arguments ``scenario`` and ``start``, see `PartParameters`. A maker is
    named and imported as a `Law` is.
    """

    noun = "part"
    elsewhere = "pass it in Python by Scenario.with_part"
    _last: Any = None

    def make(self, arguments: Mapping[str, Any]) -> Any:
        """Return a new Drake system.

        ``arguments`` has the values of the arguments that a function may have. Raises
        `ParameterError` if the maker makes no Drake system, or is a system that cannot be cloned.
        """
        if self.is_object:
            # Drake clones a leaf system in Python by its conversions only.
            converted = self.target.ToAutoDiffXdMaybe()
            if converted is None:
                return self.make_system()
            return converted.ToScalarType[float]()
        subject = self.subject
        with user_code(f"{subject}: cannot be made"):
            known = inspect.signature(self.target).parameters
            offered = arguments.keys() & {"scenario", "start"} - known.keys()
            if unknown := arguments.keys() - known.keys() - offered:
                hint = question(close_names(min(unknown), known))
                raise ParameterError(f"{subject}: has no argument {min(unknown)}{hint}")
            system = self.target(**{n: v for n, v in arguments.items() if n not in offered})
        if not hasattr(type(system), "CreateDefaultContext"):
            raise ParameterError(
                f"{subject}: returns {type(system).__name__}; must return a Drake system"
            )
        if system is self._last:
            raise ParameterError(
                f"{subject}: returns one system twice; must make a new one at each call"
            )
        self._last = system
        return system

    @property
    def is_system(self) -> bool:
        """True: whatever the maker is, it makes a Drake system."""
        return True

    @property
    def takes_scenario(self) -> bool:
        """Whether the maker is a function with the argument ``scenario``."""
        return not self.is_object and "scenario" in self._parameters

    @property
    def is_object(self) -> bool:
        """Whether the user gave a system itself, and no class or function."""
        return hasattr(type(self.target), "CreateDefaultContext")


class PartParameters(Parameters):
    """A Drake system of the user in place of a leaf system of kneexo, with the same ports.

    The system must have the output ports of the leaf system that it replaces in the scenario, and
    read what acts on that leaf. More states, outputs and Context parameters are welcome. Without a
    symbolic form of the part, Drake's Simulator makes the runs.

    ``make`` is a system, or a class or function that makes one. A function may have the arguments
    ``scenario``, and ``start``, the dictionary that `kneexo.diagrams.cylinder_start` returns. All
    its other arguments are numbers, which ``values`` changes; ``--set`` and uncertainty sets reach
    them by paths such as ``parts.cylinder.values.coulomb_n``.
    """

    make: PartMaker = choice(..., "given by the user: FILE.py:NAME of a Drake system")
    values: dict[str, float] = choice({}, "given by the user: numbers of the part, by argument")

    def system(self, scenario: Any, start: Mapping[str, Any]) -> Any:
        """Return a new Drake system of the part, as `PartMaker.make` does."""
        return self.make.make({"scenario": scenario, "start": start, **self.values})

    def __hash__(self) -> int:
        """Return a hash of the maker and the sorted values."""
        return hash((self.make, tuple(sorted(self.values.items()))))


class PartsParameters(Parameters):
    """The parts of the user in place of leaf systems of kneexo."""

    cylinder: PartParameters | None = choice(None, "left out: that of plant.cylinder")
    motor: PartParameters | None = choice(None, "left out: that of plant.pump and plant.motor")
    load: PartParameters | None = choice(None, "left out: that of plant.load")
    estimator: PartParameters | None = choice(None, "left out: that of estimator")

    @field_validator("*", mode="before")
    @classmethod
    def _short_form(cls, part: Any) -> Any:
        """Accept the maker alone in place of a mapping."""
        is_whole = part is None or isinstance(part, Mapping | PartParameters)
        return part if is_whole else {"make": part}

    def chosen(self) -> dict[str, PartParameters]:
        """Return the parts that there are, by the name of their place."""
        return {name: part for name, part in vars(self).items() if part is not None}


NUMBERS = {"cylinder": ("cylinder", "full_order"), "motor": ("pump", "motor"), "load": ("load",)}
"""For each place of a part of the plant, the parameters of the plant that the part replaces."""
