"""The command ``play``, which writes a page to play with the closed loop."""

from __future__ import annotations

from typing import Any

from kneexo.command_line import arguments
from kneexo.command_line.arguments import PAPER
from kneexo.command_line.outcome import Outcome
from kneexo.command_line.request import Request, named_in_errors
from kneexo.command_line.view import run_names
from kneexo.errors import shown
from kneexo.version import __version__


def add_play(subparsers: Any) -> None:
    """Add the command ``play`` to the parser."""
    parser = arguments.add_command(
        subparsers,
        "play",
        play,
        "make a page to play with: sliders, curves and the moving leg in the browser",
        "The page is one file that any browser opens without network. The closed loop runs in the "
        "browser, so a changed value shows its effect at once. The page compares two scenarios.",
        duration_s=3.0,
    )
    parser.add_argument(
        "scenarios",
        nargs="*",
        metavar="SCENARIO.yaml",
        help=f"scenario files, of which the page compares two at a time; left out: {PAPER}",
    )
    arguments.add_preset(parser)
    arguments.add_values(parser)
    parser.add_argument(
        "--compare",
        metavar="NAME",
        help="unchanged preset to compare with: paper, bench, leg or wearer",
    )
    arguments.add_page(parser)


def play(request: Request) -> Outcome:
    """Return an outcome with an HTML page on which a user runs and changes closed loops.

    Without scenario files the page has the preset, by default the paper's setup. The preset of
    ``--compare`` is without the changes of ``--set``.
    """
    from kneexo.command_line.output import to_json
    from kneexo.page.playground import (
        LONGEST_RUN_S,
        missing_models,
        page_of,
        playground_data,
    )
    from kneexo.parameters import Scenario
    from kneexo.view.web_page import require_page_name

    paths: list[str] = request.scenarios
    require_page_name(request.out)
    names = [", ".join([name, *request.values]) for name in run_names(paths, request.preset)]
    loaded = []
    for path in paths or (None,):
        with named_in_errors(path):
            loaded.append(request.load(path))
    if request.compare is not None:
        names.append(f"preset {request.compare}")
        loaded.append(Scenario.preset(request.compare))
    # With several files the error does not say which one is at fault.
    with named_in_errors(paths[0] if len(paths) == 1 else None):
        data = playground_data(loaded, names)
    page = page_of(data)
    notes = [f"kneexo: {shown(text)}" for text in missing_models(data)]
    notes += [
        f"kneexo: {shown(name)}: a run on the page has the first {LONGEST_RUN_S:g} of "
        f"{scenario.duration_s:g} s"
        for name, scenario in zip(names, loaded, strict=True)
        if scenario.duration_s > LONGEST_RUN_S
    ]
    size_mb = len(page.encode()) / 1e6
    return Outcome(
        f"{shown(request.out)} ({size_mb:.1f} MB): {', '.join(map(shown, names))}; open it in a "
        f"browser\n",
        to_json({"kneexo": __version__, "page": str(request.out), "scenarios": names}),
        notes,
        page=page,
    )
