"""The studies of the command line, one row for each.

A study NAME is a package ``kneexo.studies.NAME``. Its settings and its function are the package's
names for users. Its module ``report`` fills the template ``report.md``, which describes a result in
Markdown. Its module ``figures`` draws the result. The command line and the tests read this
catalogue. No study imports it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING, Any

from kneexo.common.progress import Stage

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kneexo.parameters import Scenario
    from kneexo.parameters.fields.quantity import Parameters
    from kneexo.view.legs import Motion


@dataclass(frozen=True)
class Computation:
    """The settings of a study, and the function that runs it."""

    settings: type[Parameters]
    """The class of the study's settings."""
    compute: Callable[..., Any]
    """Runs the study and returns its result, whose method ``results()`` returns plain data.

    The function's arguments are the scenario, ``settings``, ``workers``, ``executor`` and
    ``progress``. A resumable study also accepts ``checkpoint``. An uncertain study also accepts
    ``uncertainty``.
    """

    @property
    def scenario(self) -> Scenario:
        """The default scenario of `compute`."""
        default: Scenario = inspect.signature(self.compute).parameters["scenario"].default
        return default


@dataclass(frozen=True)
class Presentation:
    """The functions that show the result of a study. Each takes the result."""

    report: Callable[[Any], str]
    """Returns the report in Markdown."""
    figures: Callable[[Any], Mapping[str, Figure]]
    """Draws the figures. Returns a dictionary from name to figure."""
    _: KW_ONLY
    motions: Callable[[Any], Mapping[str, Motion]] = lambda result: {}
    """Returns the runs that the 3D view shows, by title."""
    failed_runs: Callable[[Any], Mapping[str, Scenario]] = lambda result: {}
    """Returns a dictionary from error to the scenario of a run that failed with this error.

    The dictionary has an example of each kind of failure.
    """
    scenarios: Callable[[Any], Mapping[str, Scenario]] = lambda result: {}
    """Returns the scenarios that the study has made, by the names of their files."""
    comments: Callable[[Any], str] = lambda result: ""
    """Returns the comment lines with which the files of these scenarios begin."""


@dataclass(frozen=True)
class Study:
    """One study of the command line."""

    name: str
    command: str
    """Words that follow ``kneexo`` to run the study, such as ``study bandwidth``."""
    summary: str
    detail: str = ""
    _: KW_ONLY
    # `kneexo --help` reads the catalogue, so studies are imported by calls of these two functions.
    # They are two because `kneexo params` needs no Matplotlib, whose import takes 0.4 s.
    computation: Callable[[], Computation]
    """Imports the settings and the function of the study."""
    presentation: Callable[[], Presentation]
    """Imports what shows a result of the study."""
    setup: str = ""
    """Description of the default scenario, or an empty text for the paper's setup."""
    arguments: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Settings that are arguments of the command too: by name or option, metavar and help.

    An option has a list of texts with commas between them.
    """
    takes_scenario: bool = True
    """False if the command always runs the scenarios of the paper."""
    uncertain: bool = False
    """True if the study varies the values of an uncertainty set."""
    resumable: bool = True
    """True if an interrupted study can continue from a checkpoint of its finished runs."""
    files: tuple[str, str] = ("", "")
    """File names of results and report. An empty name stands for NAME.json or NAME.md."""
    stages: tuple[Stage, ...]
    """The progress bars of the study in their order, with their typical durations.

    A duration is the wall time from the start of a bar to the start of the next one, measured with
    the default settings on two cores without other work.
    """
    drawing_s: float
    """Typical duration in s of drawing the figures, measured like the stages."""
    writing_s: float
    """Typical duration in s of writing the files, measured like the stages."""
    amounts: tuple[str, ...] = ()
    """Settings that are numbers of plants, of which a tenth gives a first answer."""
    label: str = ""
    """Heading of the study's settings in ``kneexo params``, or an empty text for ``command``."""


def _reproduce() -> Computation:
    from kneexo.studies.reproduce import ReproduceSettings, reproduce_study

    return Computation(ReproduceSettings, reproduce_study)


def _reproduce_shown() -> Presentation:
    from kneexo.studies.reproduce import figures, report

    return Presentation(report.report, figures.figures, motions=figures.motions)


def _bandwidth() -> Computation:
    from kneexo.studies.bandwidth import BandwidthSettings, bandwidth_study

    return Computation(BandwidthSettings, bandwidth_study)


def _bandwidth_shown() -> Presentation:
    from kneexo.studies.bandwidth import figures, report

    return Presentation(report.report, figures.figures)


def _robustness() -> Computation:
    from kneexo.studies.robustness import RobustnessSettings, robustness_study

    return Computation(RobustnessSettings, robustness_study)


def _robustness_shown() -> Presentation:
    from kneexo.studies.robustness import figures, report

    return Presentation(report.report, figures.figures, failed_runs=report.failed_runs)


def _mechanism() -> Computation:
    from kneexo.studies.mechanism import MechanismSettings, mechanism_study

    return Computation(MechanismSettings, mechanism_study)


def _mechanism_shown() -> Presentation:
    from kneexo.studies.mechanism import figures, report

    return Presentation(report.report, figures.figures)


def _controller() -> Computation:
    from kneexo.studies.controller import ControllerSettings, controller_study

    return Computation(ControllerSettings, controller_study)


def _controller_shown() -> Presentation:
    from kneexo.studies.controller import figures, report

    return Presentation(report.report, figures.figures)


def _contest() -> Computation:
    from kneexo.studies.contest import ContestSettings, contest_study

    return Computation(ContestSettings, contest_study)


def _contest_shown() -> Presentation:
    from kneexo.studies.contest import figures, report

    return Presentation(report.report, figures.figures, failed_runs=report.failed_runs)


def _faults() -> Computation:
    from kneexo.studies.faults import FaultsSettings, faults_study

    return Computation(FaultsSettings, faults_study)


def _faults_shown() -> Presentation:
    from kneexo.studies.faults import figures, report

    return Presentation(report.report, figures.figures)


def _size() -> Computation:
    from kneexo.studies.size import SizeSettings, size_study

    return Computation(SizeSettings, size_study)


def _size_shown() -> Presentation:
    from kneexo.studies.size import figures, report

    return Presentation(report.report, figures.figures, motions=figures.motions)


def _design() -> Computation:
    from kneexo.studies.design import DesignSettings, design_study

    return Computation(DesignSettings, design_study)


def _design_shown() -> Presentation:
    from kneexo.studies.design import figures, report

    return Presentation(report.report, figures.figures, scenarios=report.scenarios)


def _fit() -> Computation:
    from kneexo.studies.fit import FitSettings, fit_study

    return Computation(FitSettings, fit_study)


def _fit_shown() -> Presentation:
    from kneexo.studies.fit import figures, report

    return Presentation(
        report.report, figures.figures, scenarios=report.scenarios, comments=report.comments
    )


def _wearer() -> Computation:
    from kneexo.studies.wearer import WearerSettings, wearer_study

    return Computation(WearerSettings, wearer_study)


def _wearer_shown() -> Presentation:
    from kneexo.studies.wearer import figures, report

    return Presentation(report.report, figures.figures)


_UNDER_LOAD = "the paper's setup under the weight of the shank"

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
            computation=_reproduce,
            presentation=_reproduce_shown,
            takes_scenario=False,
            resumable=False,
            files=("results.json", "report.md"),
            label="reproduce, Fig. 13",
            stages=(
                Stage("Fig. 9, Fig. 12, Eq. 27 at 2 ms", 1.0),
                Stage("frequency response", 0.5, repeats=True),
            ),
            drawing_s=0.2,
            writing_s=2.3,
        ),
        Study(
            "bandwidth",
            "study bandwidth",
            "measure the frequency response from small to large amplitude",
            "Sinestream over frequencies and amplitudes, beside the linear prediction and the "
            "closed form of the speed limit.",
            computation=_bandwidth,
            presentation=_bandwidth_shown,
            stages=(Stage("amplitude map", 4.0),),
            drawing_s=0.5,
            writing_s=1.5,
        ),
        Study(
            "robustness",
            "study robustness",
            "worst case, spread and sensitivities over an uncertainty set",
            "Corners, seeded Monte Carlo and one value at a time: tracking error, bandwidth, "
            "margins.",
            computation=_robustness,
            presentation=_robustness_shown,
            setup=_UNDER_LOAD,
            uncertain=True,
            stages=(
                Stage("nominal", 0.5),
                Stage("one at a time", 6.0),
                Stage("samples", 165.0),
                Stage("corners", 170.0, repeats=True),
                Stage("sensitivities", 1.0),
            ),
            amounts=("samples", "corners_max"),
            drawing_s=0.5,
            writing_s=2.0,
        ),
        Study(
            "mechanism",
            "study mechanism",
            "how well the linkage, a hinge and the paper's linkages follow the wearer's knee",
            "Migration of the strap on the shank, wrong places, torque that arrives at the "
            "wearer's knee, forces of the cuff.",
            computation=_mechanism,
            presentation=_mechanism_shown,
            resumable=False,
            stages=(Stage("devices", 0.3),),
            drawing_s=0.5,
            writing_s=2.0,
        ),
        Study(
            "controller",
            "study controller",
            "errors, chattering and margins over λ, Φ and η, and the paper's claims",
            computation=_controller,
            presentation=_controller_shown,
            stages=(
                Stage("grid of λ, Φ, η", 3.7),
                Stage("limit cycle", 0.2),
                Stage("map of T_f, k/Φ", 0.6),
            ),
            drawing_s=0.5,
            writing_s=3.0,
        ),
        Study(
            "contest",
            "study contest",
            "SMC and PID tuned alike, compared over the uncertainty set",
            computation=_contest,
            presentation=_contest_shown,
            setup=_UNDER_LOAD,
            uncertain=True,
            stages=(
                Stage("budget of chattering", 2.0),
                Stage("tuning", 1300.0),
                Stage("test", 100.0),
                Stage("other reference", 6.0),
            ),
            drawing_s=0.2,
            writing_s=0.8,
        ),
        Study(
            "faults",
            "study faults",
            "what faults do, and whether the protection acts in time",
            "Typical faults at several times of the motion, critical durations, detectors, safe "
            "states, false alarms of healthy knees.",
            computation=_faults,
            presentation=_faults_shown,
            setup="the preset protected",
            uncertain=True,
            stages=(
                Stage("faults", 380.0, repeats=True),
                Stage("healthy runs", 10.0),
            ),
            drawing_s=0.5,
            writing_s=2.0,
        ),
        Study(
            "size",
            "size",
            "find the motor, pump and encoder that a task needs",
            "Bandwidth and error over the hardware, and what walking takes.",
            computation=_size,
            presentation=_size_shown,
            setup=_UNDER_LOAD,
            stages=(
                Stage("hardware: bandwidth and error", 4.0),
                Stage("flow and acceleration: bandwidth", 2.0),
                Stage("gains for walking", 7.0),
                Stage("around the design", 3.5),
            ),
            drawing_s=0.3,
            writing_s=2.0,
        ),
        Study(
            "design",
            "design",
            "find a linkage that follows a wearer's knee, within limits",
            "Reads the motion of the knee from a file (--set knee=knee.csv). Writes a scenario "
            "with the linkage (linkage.yaml).",
            computation=_design,
            presentation=_design_shown,
            resumable=False,
            stages=(Stage("search", 3.0),),
            drawing_s=0.2,
            writing_s=0.5,
        ),
        Study(
            "fit",
            "fit",
            "fit a scenario to a log of the real machine, and say how far to trust each number",
            "Open loop from the logged command, and in the whole loop. Writes fitted.yaml.",
            computation=_fit,
            presentation=_fit_shown,
            arguments={
                "log": ("LOG.csv", "the log, with columns of a signals.csv of `kneexo simulate`"),
                "--parameters": ("NAME[=LOW:HIGH],…", "what to find: plant.pump.lag_s=0.001:0.1"),
                "--columns": ("NAME=COLUMN,…", "other names and units: time_s=t_ms*0.001"),
            },
            resumable=False,
            stages=(Stage("fit", 4.0),),
            drawing_s=0.2,
            writing_s=0.5,
        ),
        Study(
            "wearer",
            "study wearer",
            "what the wearer feels, and how much help the wearer gets",
            "Torque between leg and knee in walking and sit-to-stand, with other pumps and gains. "
            "Help for weak legs with each mode of torque control.",
            computation=_wearer,
            presentation=_wearer_shown,
            setup="full order of the cylinder, weight of the shank, torque control and a wearer",
            stages=(
                Stage("torque of wearers", 62.0),
                Stage("margins", 4.0),
            ),
            drawing_s=1.0,
            writing_s=2.0,
        ),
    )
}
"""Dictionary from the name of a study to its `Study`."""
