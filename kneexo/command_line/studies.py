"""The studies of the catalogue as commands."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kneexo.command_line.html_page import ReportPage
from kneexo.command_line.options import (
    HelpFormatter,
    ScenarioChoice,
    add_command,
    add_engine,
    add_html,
    add_out,
    add_scenario,
    add_set,
    integer,
    origin_of,
    report_page,
    scenario_choice,
    scenario_request,
    with_values,
)
from kneexo.command_line.outcome import Outcome, Request, file_names
from kneexo.errors import ParameterError, shown
from kneexo.studies.catalogue import Study

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from kneexo.sweeps.checkpoint import Checkpoint


def add_studies(subparsers: Any, studies: Iterable[Study]) -> None:
    """Add a command for each study; ``study NAME`` becomes a command of the group ``study``."""
    groups = {"": subparsers}
    for study in studies:
        group, _, name = study.command.rpartition(" ")
        if group not in groups:
            summary = "compare controllers, or the full order with the reduced one"
            parser = subparsers.add_parser(group, help=summary, formatter_class=HelpFormatter)
            groups[group] = parser.add_subparsers(title="studies", required=True, metavar="STUDY")
        _add_study(groups[group], name, study)


def _add_study(group: Any, name: str, study: Study) -> None:
    parser = add_command(group, name, partial(_request, study), study.summary, study.detail)
    if study.setup:
        add_scenario(parser, study.setup)
    add_engine(parser)
    add_out(parser, "figures (PNG, PDF), results (JSON) and report (Markdown)")
    add_html(parser)
    label = study.label or study.command
    listed = f"`kneexo params` lists them with their defaults after '{label}:'"
    add_set(parser, f"a setting, by its dotted name; {listed}", "settings")
    if study.uncertain:
        parser.add_argument(
            "--uncertainty",
            metavar="FILE.yaml",
            help="values by dotted path, each {low, high, scale} or {options}; left out: the "
            "default set (see `kneexo params`)",
        )
    workers = parser.add_mutually_exclusive_group()
    workers.add_argument(
        "--workers", type=integer, metavar="N", help="processes; left out: one for each core"
    )
    workers.add_argument(
        "--dask",
        metavar="tcp://HOST:PORT",
        help="run on the workers of this Dask cluster instead; they need the same version of "
        "kneexo (pip install 'kneexo[cluster]')",
    )
    if study.resumable:
        earlier = parser.add_mutually_exclusive_group()
        earlier.add_argument(
            "--resume",
            action="store_true",
            help="go on from the finished pieces that an interrupted run left in the directory; "
            "always so without --restart",
        )
        earlier.add_argument(
            "--restart",
            action="store_true",
            help="delete these finished pieces and begin anew",
        )


def _request(study: Study, options: argparse.Namespace) -> Request:
    run = partial(
        run_study,
        study,
        scenario_choice(options),
        options.settings,
        out=options.out,
        page=report_page(options, study.command),
        uncertainty=getattr(options, "uncertainty", None),
        workers=options.workers,
        dask=options.dask,
    )
    name = study.command.split()[-1]
    return scenario_request(
        options,
        run,
        directory=options.out,
        checkpoint_path=options.out / f"{name}.checkpoint.jsonl" if study.resumable else None,
        restart=getattr(options, "restart", False),
        uses_workers=True,
    )


def run_study(
    study: Study,
    choice: ScenarioChoice,
    settings_texts: Sequence[str],
    *,
    out: Path,
    page: ReportPage | None = None,
    uncertainty: str | None = None,
    workers: int | None = None,
    dask: str | None = None,
    checkpoint: Checkpoint | None = None,
) -> Outcome:
    """Run a study.

    Parameters
    ----------
    study
        The row of the catalogue.
    choice
        The scenario; without a file the default of the study.
    settings_texts
        Changes of the settings, each NAME=VALUE.
    out
        The directory of the results, which the text names.
    page
        The HTML page of the report; None: no page.
    uncertainty
        A file with uncertain values; None: the default set. Only for a study that is `uncertain`.
    workers
        Number of processes; None: one for each core.
    dask
        Address of a Dask cluster that replaces the processes.
    checkpoint
        Keeps finished pieces. Only for a study that is `resumable`.
    """
    scenario = choice.load(study.scenario)
    settings = with_values(study.settings(), settings_texts)
    compute = study.compute
    if uncertainty is not None:
        from kneexo.parameters.scenario_file import load_uncertainty

        compute = partial(compute, uncertainty=load_uncertainty(uncertainty, scenario))
    import matplotlib.pyplot  # noqa: F401  (if this fails, it fails before the work)

    from kneexo.command_line.output import to_json

    if page is not None:
        page.require_replaceable()
    if checkpoint is not None:
        compute = partial(compute, checkpoint=checkpoint)
    with _executor(workers, dask) as executor:
        result = compute(
            scenario, settings=settings, workers=workers, executor=executor, progress=True
        )
    origin = origin_of(scenario, settings)
    document = to_json(origin | result.results())
    report = study.report(result)
    results_file, report_file = study.files
    files = {
        results_file or f"{study.name}.json": document,
        report_file or f"{study.name}.md": report,
    }
    figures = study.figures(result)
    if page is not None:
        files |= page.file(report, figures, origin, study.motions(result))
    names = ", ".join(file_names(files, figures))
    text = f"{report}\nIn {shown(out)}: {names}\n"
    return Outcome(text, document, files=files, figures=figures)


def _executor(workers: int | None, dask: str | None) -> AbstractContextManager[Executor | None]:
    """Return the Dask cluster at the address ``dask``; None lets the study start processes."""
    if workers is not None and workers < 1:
        raise ParameterError(f"--workers = {workers}: must be at least 1")
    if dask is None:
        return nullcontext()
    from kneexo.sweeps.parallel import dask_cluster

    return dask_cluster(dask)
