"""The studies of the command line, one row for each.

A study NAME is a package ``kneexo.studies.NAME`` with ``NAMESettings`` and
``NAME_study(scenario, …)``. Its module ``report`` fills the template ``report.md``, which describes
a result in Markdown. Its module ``figures`` draws the result. The command line and the tests read
this catalogue.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from kneexo.common.progress import Stage

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kneexo.common.result import Array
    from kneexo.parameters import PlantParameters, Scenario
    from kneexo.parameters.fields.quantity import Parameters

    Motion = tuple[PlantParameters, Mapping[str, Array]]
    """A plant, and a run of this plant: columns (n,) by name. ``time_s`` starts at 0."""

PAPER = "the paper's setup (see `kneexo params`)"
"""Description of the default `Scenario` in the help of the commands and in reports."""
FIGURES = "figures"
"""Description of the progress bar of drawing a study's figures."""
FILES = "files"
"""Description of the progress bar of writing a study's files."""
_UNDER_LOAD = "the paper's setup under the weight of the shank"


@dataclass(frozen=True)
class Study:
    """One study of the command line. The study's own modules are imported at their first use."""

    name: str
    command: str
    """Words that follow ``kneexo`` to run the study, such as ``study bandwidth``."""
    summary: str
    detail: str = ""
    setup: str = _UNDER_LOAD
    """Description of the default scenario, or an empty text if the command has no scenario."""
    uncertain: bool = False
    """True if the study varies the values of an uncertainty set."""
    resumable: bool = True
    """True if an interrupted study can continue from a checkpoint of its finished runs."""
    files: tuple[str, str] = ("", "")
    """File names of results and report. An empty name stands for NAME.json or NAME.md."""
    stages: tuple[Stage, ...] = ()
    """The progress bars of the study in their order, with their typical durations.

    A duration is the wall time from the start of a bar to the start of the next one, measured with
    the default settings on two cores without other work.
    """
    label: str = ""
    """Heading of the study's settings in ``kneexo params``, or an empty text for ``command``."""

    @property
    def duration_s(self) -> float:
        """Typical duration in s of the command on two cores, with the default settings."""
        return sum(stage.duration_s for stage in self.stages)

    @property
    def settings(self) -> type[Parameters]:
        """The class of the study's settings."""
        settings_class: type[Parameters] = self._part("", f"{self.name.capitalize()}Settings")
        return settings_class

    @property
    def compute(self) -> Callable[..., Any]:
        """The function that runs the study and returns its result.

        The function's arguments are the scenario, ``settings``, ``workers``, ``executor`` and
        ``progress``. A `resumable` study also accepts ``checkpoint``. An `uncertain` study also
        accepts ``uncertainty``. The result has a method ``results()``, which returns plain data.
        """
        function: Callable[..., Any] = self._part("", f"{self.name}_study")
        return function

    @property
    def scenario(self) -> Scenario:
        """The default scenario of `compute`."""
        default: Scenario = inspect.signature(self.compute).parameters["scenario"].default
        return default

    def report(self, result: Any) -> str:
        """Return the report on a result in Markdown."""
        text: str = self._part(".report", "report")(result)
        return text

    def figures(self, result: Any) -> dict[str, Figure]:
        """Draw the figures of a result. Return a dictionary from name to figure."""
        pictures: dict[str, Figure] = self._part(".figures", "figures")(result)
        return pictures

    def motions(self, result: Any) -> dict[str, Motion]:
        """Return the runs of a result that the 3D view shows, by title.

        The dictionary is empty if the module ``figures`` has no function ``motions``.
        """
        motions = self._part(".figures", "motions", lambda result: {})
        runs: dict[str, Motion] = motions(result)
        return runs

    def failed_runs(self, result: Any) -> dict[str, Scenario]:
        """Return a dictionary from error to the scenario of a run that failed with this error.

        The dictionary has an example of each kind of failure. The dictionary is empty if the module
        ``report`` has no function ``failed_runs``.
        """
        failed = self._part(".report", "failed_runs", lambda result: {})
        runs: dict[str, Scenario] = failed(result)
        return runs

    def scenarios(self, result: Any) -> dict[str, Scenario]:
        """Return the scenarios that a result has made, by the names of their files.

        The dictionary is empty if the module ``report`` has no function ``scenarios``.
        """
        scenarios = self._part(".report", "scenarios", lambda result: {})
        made: dict[str, Scenario] = scenarios(result)
        return made

    def _part(self, module: str, name: str, *default: Callable[[Any], Any]) -> Any:
        return getattr(import_module(f"kneexo.studies.{self.name}{module}"), name, *default)


def failure_file(number: int) -> str:
    """Return the name of the file of failed run ``number`` of a study, counted from 1."""
    return f"failure_{number}.yaml"


def repeating_commands(errors: Iterable[str]) -> dict[str, str]:
    """Return for each error of `Study.failed_runs` the command that repeats the run, as code."""
    return {
        error: f"`kneexo simulate {failure_file(number)} --out failure_{number}`"
        for number, error in enumerate(errors, start=1)
    }


STUDIES = {
    study.name: study
    for study in (
        Study(
            "reproduce",
            "reproduce",
            "compute every figure and number of the paper",
            "Table 1 and Fig. 5 (linkage), Fig. 9 (ideal sliding mode), Fig. 12 (tracking with SMC "
            "and PID), Fig. 13 (frequency response), and Eq. 27 taken literally at 2 ms. "
            "The first time takes some seconds more, to compile the equations.",
            setup="",
            resumable=False,
            files=("results.json", "report.md"),
            label="reproduce, Fig. 13",
            stages=(
                Stage("Fig. 9, Fig. 12, Eq. 27 at 2 ms", 1.0),
                Stage("frequency response", 0.5, repeats=True),
                Stage(FIGURES, 0.2),
                Stage(FILES, 2.3),
            ),
        ),
        Study(
            "bandwidth",
            "study bandwidth",
            "measure the frequency response from small to large amplitude",
            "Sinestream over frequencies and amplitudes, beside the linear prediction and the "
            "closed form of the speed limit.",
            setup=PAPER,
            stages=(
                Stage("amplitude map", 4.0),
                Stage(FIGURES, 0.5),
                Stage(FILES, 1.5),
            ),
        ),
        Study(
            "robustness",
            "study robustness",
            "worst case, spread and sensitivities over an uncertainty set",
            "Corners, seeded Monte Carlo and one value at a time: tracking error, bandwidth, "
            "margins.",
            uncertain=True,
            stages=(
                Stage("nominal", 0.5),
                Stage("one at a time", 6.0),
                Stage("samples", 165.0),
                Stage("corners", 170.0, repeats=True),
                Stage("sensitivities", 1.0),
                Stage(FIGURES, 0.5),
                Stage(FILES, 2.0),
            ),
        ),
        Study(
            "mechanism",
            "study mechanism",
            "how well the linkage, a hinge and the paper's linkages follow the wearer's knee",
            "Migration of the strap on the shank, wrong places, torque that arrives at the "
            "wearer's knee, forces of the cuff.",
            setup=PAPER,
            resumable=False,
            stages=(
                Stage("devices", 0.3),
                Stage(FIGURES, 0.5),
                Stage(FILES, 2.0),
            ),
        ),
        Study(
            "controller",
            "study controller",
            "errors, chattering and margins over λ, Φ and η, and the paper's claims",
            setup=PAPER,
            stages=(
                Stage("grid of λ, Φ, η", 3.7),
                Stage("limit cycle", 0.2),
                Stage("map of T_f, k/Φ", 0.6),
                Stage(FIGURES, 0.5),
                Stage(FILES, 3.0),
            ),
        ),
        Study(
            "contest",
            "study contest",
            "SMC and PID tuned alike, compared over the uncertainty set",
            uncertain=True,
            stages=(
                Stage("budget of chattering", 2.0),
                Stage("tuning", 1300.0),
                Stage("test", 100.0),
                Stage("other reference", 6.0),
                Stage(FIGURES, 0.2),
                Stage(FILES, 0.8),
            ),
        ),
        Study(
            "faults",
            "study faults",
            "what faults do, and whether the protection acts in time",
            "Typical faults at several times of the motion, critical durations, detectors, safe "
            "states, false alarms of healthy knees.",
            setup="the preset protected",
            uncertain=True,
            stages=(
                Stage("faults", 380.0, repeats=True),
                Stage("healthy runs", 10.0),
                Stage(FIGURES, 0.5),
                Stage(FILES, 2.0),
            ),
        ),
        Study(
            "size",
            "size",
            "find the motor, pump and encoder that a task needs",
            "Bandwidth and error over the hardware, and what walking takes.",
            stages=(
                Stage("hardware: bandwidth and error", 4.0),
                Stage("flow and acceleration: bandwidth", 2.0),
                Stage("gains for walking", 7.0),
                Stage("around the design", 3.5),
                Stage(FIGURES, 0.3),
                Stage(FILES, 2.0),
            ),
        ),
        Study(
            "design",
            "design",
            "find a linkage that follows a wearer's knee, within limits",
            "Reads the motion of the knee from a file (--set knee=knee.csv). Writes a scenario "
            "with the linkage (linkage.yaml).",
            setup=PAPER,
            resumable=False,
            stages=(
                Stage("search", 3.0),
                Stage(FIGURES, 0.2),
                Stage(FILES, 0.5),
            ),
        ),
        Study(
            "wearer",
            "study wearer",
            "what the wearer feels, and how much help the wearer gets",
            "Torque between leg and knee in walking and sit-to-stand, with other pumps and gains. "
            "Help for weak legs with each mode of torque control.",
            setup="full order of the cylinder, weight of the shank, torque control and a wearer",
            stages=(
                Stage("torque of wearers", 62.0),
                Stage("margins", 4.0),
                Stage(FIGURES, 1.0),
                Stage(FILES, 2.0),
            ),
        ),
    )
}
"""Dictionary from the name of a study to its `Study`."""
