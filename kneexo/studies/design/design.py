"""Searches for a linkage that follows a wearer's knee, with a given rod map, within limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Unpack

from kneexo.analysis import LinkageDesign, design_linkage
from kneexo.analysis.mechanism.alignment import Alignment, align
from kneexo.analysis.mechanism.linkage_design import RodTarget
from kneexo.common.files.table import SUFFIXES, read_table
from kneexo.common.progress import progress_bar
from kneexo.common.result import Result
from kneexo.errors import ParameterError, shown
from kneexo.geometry.linkage_properties import linkage_properties
from kneexo.parameters import (
    GAIT2392,
    HINGE,
    AnatomicalKneeParameters,
    DesignLimits,
    RodPolynomialParameters,
    Scenario,
)
from kneexo.parameters.fields.quantity import Parameters, choice, quantity
from kneexo.parameters.wearer.anatomical_knee import KneeChoice
from kneexo.sweeps import SweepOptions


class DesignSettings(Parameters):
    """Settings of ``kneexo design``: what the linkage follows, its limits, and the search."""

    knee: KneeChoice = GAIT2392
    rod: str = choice(
        "table_1", "Table 1; none, or the path of a .csv file with knee_angle_deg, rod_extension_mm"
    )
    """Rod map that the linkage obeys. With ``none`` the knee alone counts."""
    limits: DesignLimits = DesignLimits()
    seed: int = quantity(0, "1", "assumption: seed of the random linkages", ge=0, le=10**9)
    starts: int = quantity(
        120, "1", "assumption: random linkages that the search improves", ge=1, le=10_000
    )


@dataclass(frozen=True, repr=False)
class DesignResult(Result):
    """A designed linkage, beside a hinge and the linkage of the scenario, each at its best place.

    In ``scenario`` the designed linkage is the plant's.
    """

    scenario: Scenario
    settings: DesignSettings
    design: LinkageDesign
    others: dict[str, Alignment]

    def results(self) -> dict[str, Any]:
        """Return the numbers of the design as plain data."""
        design, own = self.design, linkage_properties(self.design.linkage)
        return {
            "linkage": design.linkage.model_dump(mode="json"),
            "rms_mm": design.rms_mm,
            "largest_mm": design.largest_mm,
            "rod_rms_mm": design.rod_rms_mm,
            "rod_largest_mm": design.rod_largest_mm,
            "binding": list(design.binding),
            "thigh_as_ground": own.thigh_as_ground,
            "shank_as_ground": own.shank_as_ground,
            "finished_mm": design.finished_mm,
            "others": {
                name: {"rms_mm": other.rms_mm, "largest_mm": other.largest_mm}
                for name, other in self.others.items()
            },
        }


def design_study(
    scenario: Scenario = Scenario(),
    *,
    settings: DesignSettings = DesignSettings(),
    **options: Unpack[SweepOptions],
) -> DesignResult:
    """Search for a linkage within limits, and put it into a scenario.

    Parameters
    ----------
    scenario
        The scenario whose linkage is replaced.
    settings
        The wearer's knee, the rod map, the limits and the search.
    **options
        Those of `kneexo.sweeps.SweepOptions`. Only ``progress`` has an effect.

    Raises
    ------
    LinkageError
        The linkage of the scenario cannot be assembled.
    ParameterError
        As `kneexo.analysis.design_linkage`, or for a rod map that is neither a word nor a file.
    """
    others = {"hinge": HINGE, "linkage of the scenario": scenario.plant.linkage}
    knee: AnatomicalKneeParameters = settings.knee
    aligned = {name: align(linkage, knee) for name, linkage in others.items()}
    with progress_bar(1.0, "search" if options.get("progress") else None):
        design = design_linkage(
            knee,
            _rod_target(settings.rod),
            settings.limits,
            seed=settings.seed,
            starts=settings.starts,
        )
    plant = scenario.plant.model_copy(update={"linkage": design.linkage})
    return DesignResult(scenario.model_copy(update={"plant": plant}), settings, design, aligned)


def _rod_target(rod: str) -> RodTarget | None:
    if rod.endswith(SUFFIXES):
        columns = read_table(rod, ("knee_angle_deg", "rod_extension_mm")).columns
        return columns["knee_angle_deg"], columns["rod_extension_mm"]
    if rod not in ("table_1", "none"):
        raise ParameterError(f"rod = {shown(rod)}: must be table_1, none or a path of a .csv file")
    return RodPolynomialParameters() if rod == "table_1" else None
