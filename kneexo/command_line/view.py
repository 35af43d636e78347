"""The command ``view``, which shows runs in three dimensions."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kneexo.command_line import arguments
from kneexo.command_line.arguments import PAPER
from kneexo.command_line.outcome import Outcome
from kneexo.command_line.request import Request, named_in_errors
from kneexo.errors import ParameterError, shown
from kneexo.version import __version__


def add_view(subparsers: Any) -> None:
    """Add the command ``view`` to the parser."""
    parser = arguments.add_command(
        subparsers,
        "view",
        view,
        "show runs in three dimensions: an HTML page with a time slider",
        "The page is one file that any browser opens without network. Several runs stand beside "
        "each other. The cylinder's colour is its pressure. The black outline is the reference.",
    )
    parser.add_argument(
        "runs",
        nargs="*",
        metavar="RUN",
        help=f"scenario files to run, or directories that `kneexo simulate` wrote; left out: "
        f"{PAPER}",
    )
    arguments.add_preset(parser)
    arguments.add_values(parser)
    arguments.add_page(parser)


def view(request: Request) -> Outcome:
    """Return an outcome with an HTML page that shows runs in three dimensions.

    Each run is a scenario file, or a directory that ``kneexo simulate`` wrote. The arguments change
    the scenarios of files only. Without runs the page shows the preset, by default the paper's
    setup.
    """
    from kneexo.command_line.output import to_json
    from kneexo.parameters.scenario_file import load_scenario
    from kneexo.view.legs import leg_of_results, leg_of_scenario
    from kneexo.view.page import MOST_LEGS, shown_s, view_page
    from kneexo.view.web_page import require_page_name

    runs: list[str] = request.runs
    values, preset = request.values, request.preset
    require_page_name(request.out)
    if len(runs) > MOST_LEGS:
        raise ParameterError(f"{len(runs)} runs: a page shows {MOST_LEGS} at most")
    if (values or preset) and (results := [run for run in runs if Path(run).is_dir()]):
        raise ParameterError(
            f"{'--set' if values else '--preset'}: {shown(results[0])} holds a finished run; its "
            f"values are fixed"
        )
    legs, notices = [], []
    for name, run in zip(run_names(runs, preset), runs or (None,), strict=True):
        if run is not None and Path(run).is_dir():
            if not Path(run, "scenario.yaml").exists():
                raise ParameterError(
                    f"{shown(run)}: has no scenario.yaml; must be a directory of kneexo simulate"
                )
            scenario = load_scenario(Path(run, "scenario.yaml"), without_law=True)
            legs.append(leg_of_results(name, Path(run), scenario))
            continue
        start = [f"preset {preset}"] if run and preset else []
        caption = ", ".join([name, *start, *values])
        with named_in_errors(run):
            leg, failure = leg_of_scenario(caption, request.load(run))
        if failure:
            notices.append(f"kneexo: {shown(caption)}: {failure}; shown up to there")
        legs.append(leg)
    if (end_s := shown_s(legs)) < max(leg.time_s[-1] for leg in legs):
        notices.append(f"kneexo: the page is full, so it shows only the first {end_s:.4g} s")
    names = [leg.name for leg in legs]
    return Outcome(
        f"{shown(request.out)}: {', '.join(map(shown, names))}; open it in a browser\n",
        to_json({"kneexo": __version__, "page": str(request.out), "runs": names}),
        notices,
        page=view_page(legs),
    )


def run_names(runs: Sequence[str], preset: str | None = None) -> list[str]:
    """Return a unique name for each path in ``runs``; if there are none, the name of the preset.

    A name is that of the file without suffix, or of the directory. Equal names get the parent
    directory in front. If they are still equal, the paths as typed are the names. A path that is
    typed again gets (2), (3), ….
    """
    if not runs:
        return [f"preset {preset}" if preset else "the paper's setup"]
    paths = [Path(os.path.realpath(run)) for run in runs]
    names = [path.name if path.is_dir() else path.stem for path in paths]
    in_parent = [f"{path.parent.name}/{name}" for path, name in zip(paths, names, strict=True)]
    for longer in (in_parent, runs):
        pairs = zip(names, longer, strict=True)
        names = [other if names.count(name) > 1 else name for name, other in pairs]
    times = [names[: index + 1].count(name) for index, name in enumerate(names)]
    return [
        name if time == 1 else f"{name} ({time})" for name, time in zip(names, times, strict=True)
    ]
