"""The studies of the command line, a row each.

A study NAME is a folder ``kneexo/studies/NAME``. Its module ``study`` has ``NAMESettings`` and
``NAME_study(scenario, …)``, ``report.report`` writes the result as Markdown, and
``figures.figures`` draws it. The command line and the tests read this catalogue.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kneexo.parameters import LinkageParameters, Scenario
    from kneexo.parameters.quantity import Parameters
    from kneexo.result import Array

    Motion = tuple[LinkageParameters, Mapping[str, Array]]
    """A linkage, and columns of a run with it by name, with ``time_s`` from 0 on, (n,) each."""

PAPER = "the paper's setup (see `kneexo params`)"
"""What help and reports call the default scenario of most studies."""
_UNDER_LOAD = "the paper's setup under the weight of the shank"


@dataclass(frozen=True)
class Study:
    """A study; its modules are imported when something of them is asked for."""

    name: str
    command: str
    """What to type after ``kneexo``."""
    summary: str
    detail: str = ""
    setup: str = _UNDER_LOAD
    """What the scenario is when none is given; empty where the command line takes none."""
    uncertain: bool = False
    """Whether it takes an uncertainty set."""
    resumable: bool = True
    """Whether its pieces of work are plain data, which a checkpoint keeps."""
    moving: bool = False
    """Whether its result has `motions`."""
    files: tuple[str, str] = ("", "")
    """Results and report; left out: NAME.json and NAME.md."""
    label: str = ""
    """What ``kneexo params`` lists the settings after; left out: ``command``."""

    @property
    def settings(self) -> type[Parameters]:
        """The class of its settings."""
        settings_class: type[Parameters] = self._part("study", f"{self.name.capitalize()}Settings")
        return settings_class

    @property
    def compute(self) -> Callable[..., Any]:
        """The function that runs it.

        It takes the scenario, ``settings``, ``workers``, ``executor``, ``progress``, where the
        study is `resumable` ``checkpoint`` and where it is `uncertain` ``uncertainty``. Its result
        has ``results()``.
        """
        function: Callable[..., Any] = self._part("study", f"{self.name}_study")
        return function

    @property
    def scenario(self) -> Scenario:
        """The scenario when none is given."""
        default: Scenario = inspect.signature(self.compute).parameters["scenario"].default
        return default

    def report(self, result: Any) -> str:
        """Markdown of a result."""
        text: str = self._part("report", "report")(result)
        return text

    def figures(self, result: Any) -> dict[str, Figure]:
        """Pictures of a result, by name."""
        pictures: dict[str, Figure] = self._part("figures", "figures")(result)
        return pictures

    def motions(self, result: Any) -> dict[str, Motion]:
        """Runs of a result that tell something in three dimensions, by name."""
        if not self.moving:
            return {}
        runs: dict[str, Motion] = self._part("figures", "motions")(result)
        return runs

    def _part(self, module: str, name: str) -> Any:
        return getattr(import_module(f"kneexo.studies.{self.name}.{module}"), name)


STUDIES = {
    study.name: study
    for study in (
        Study(
            "reproduce",
            "reproduce",
            "compute every figure and number of the paper",
            "Table 1 and Fig. 5 (linkage), Fig. 9 (ideal sliding mode), Fig. 12 (tracking with SMC "
            "and PID), Fig. 13 (frequency response), and Eq. 27 taken literally at 2 ms. "
            "Takes some seconds; the first time some more, to compile the equations.",
            setup="",
            resumable=False,
            moving=True,
            files=("results.json", "report.md"),
            label="reproduce, Fig. 13",
        ),
        Study(
            "bandwidth",
            "bandwidth",
            "measure the frequency response from small to large amplitude",
            "Sinestream over frequencies and amplitudes, beside the linear prediction and the "
            "closed form of the speed limit.",
            setup=PAPER,
        ),
        Study(
            "robustness",
            "robustness",
            "worst case, spread and sensitivities over an uncertainty set",
            "Corners, seeded Monte Carlo and one value at a time: tracking error, bandwidth, "
            "margins.",
            uncertain=True,
        ),
        Study(
            "controller",
            "study controller",
            "errors, chattering and margins over λ, Φ and η, and the paper's claims",
            setup=PAPER,
        ),
        Study(
            "contest",
            "study contest",
            "SMC and PID tuned alike, compared over the uncertainty set",
            uncertain=True,
        ),
        Study(
            "sliding",
            "study sliding",
            "the sliding condition and the bound on the error",
            setup="ideal motor and exact states in continuous time",
        ),
        Study("order", "study order", "full against reduced order"),
        Study(
            "size",
            "size",
            "find the motor, pump and encoder that a task needs",
            "Bandwidth and error over the hardware, and what walking takes.",
            moving=True,
        ),
    )
}
"""All studies by name."""
