"""The commands ``params``, ``diagram`` and ``setup cache``."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from kneexo.command_line import arguments
from kneexo.command_line.delivery import import_drake
from kneexo.command_line.outcome import Outcome, files_line
from kneexo.command_line.request import Request, origin_of
from kneexo.version import __version__


def add_utilities(subparsers: Any) -> Any:
    """Add the commands ``params``, ``diagram`` and ``setup cache``; return the group ``setup``."""
    parser = arguments.add_command(
        subparsers,
        "params",
        params,
        "list every parameter with value, unit, range and provenance",
        "Without a scenario file also the settings of all studies. With --schema, editors complete "
        "and check scenario files: save the schema as kneexo.schema.json and begin a file with "
        "the line '# yaml-language-server: $schema=kneexo.schema.json'.",
        uses_drake=False,
    )
    arguments.add_scenario(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument(
        "--find",
        metavar="TEXT",
        help="list only parameters with this text in name, unit or provenance: mass, Table 3; "
        "'yours' for the values of the scenario file that differ from the default",
    )
    form.add_argument("--yaml", action="store_true", help="print a complete scenario file instead")
    form.add_argument(
        "--schema", action="store_true", help="print the JSON schema of scenario files instead"
    )

    parser = arguments.add_command(
        subparsers,
        "diagram",
        diagram,
        "draw the block diagram of a scenario",
        "Its blocks are the systems of the Drake diagram. The names on the wires are ports.",
        fills_directory=True,
    )
    arguments.add_scenario(parser)
    arguments.add_out(parser, "closed_loop.svg and closed_loop.png")

    setup = arguments.add_group(
        subparsers, "setup", "compiled models on disk, and completion in shells", "PART"
    )
    parser = arguments.add_command(
        setup,
        "cache",
        cache,
        "show or delete the compiled models that are kept on disk",
        "They stand in DIAGRAMC_CACHE_DIR, else in diagramc below XDG_CACHE_HOME, else in "
        "~/.cache/diagramc. DIAGRAMC_CACHE_SIZE_MB limits their total size in MiB; left out: 512.",
        uses_drake=False,
    )
    parser.add_argument("--clear", action="store_true", help="delete all of them")
    return setup


def params(request: Request) -> Outcome:
    """Return the list of all parameters, or a scenario file or its schema.

    If no scenario is given, the list also has all kinds of parts, the settings of all studies and
    the uncertain values. With ``--find`` the list has only the parameters with this text.
    """
    everything = not (request.scenario or request.preset or request.yaml or request.schema)
    if everything:
        import_drake()  # the studies, whose settings are listed, need it
    scenario = request.load(request.scenario, runs_law=False)
    if request.yaml:
        from kneexo.parameters.scenario_file import dump_scenario

        return Outcome(dump_scenario(scenario))
    if request.schema:
        from kneexo.parameters.schema import json_schema

        return Outcome(json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n")
    from kneexo.command_line.parameter_list import (
        listing,
        mark_changes,
        matching,
        parameter_rows,
        setting_rows,
        uncertainty_rows,
    )
    from kneexo.geometry.rod_polynomial import completed

    rows = list(parameter_rows(completed(scenario), all_kinds=everything))
    mark_changes(rows, scenario)
    if everything:
        rows += [*setting_rows(), *uncertainty_rows()]
    if request.find is not None:
        rows = matching(rows, request.find)
    document = {**origin_of(scenario), "parameters": rows}
    text = listing(rows, grouped=request.find is None)
    text_of_rows = json.dumps(document, indent=2, ensure_ascii=False, default=str)  # a law
    return Outcome(text, text_of_rows + "\n")


def diagram(request: Request) -> Outcome:
    """Return the block diagram of a scenario as SVG and PNG."""
    scenario = request.load(request.scenario, runs_law=False)
    from kneexo.command_line.output import svg_text
    from kneexo.view.block_diagram import block_diagram

    figure = block_diagram(scenario)
    files: dict[str, str | Callable[[Path], object]] = {
        "closed_loop.png": lambda path: figure.savefig(path, dpi=200),
        "closed_loop.svg": svg_text(figure),
    }
    document = {**origin_of(scenario), "directory": str(request.out), "files": list(files)}
    return Outcome(files_line(request.out, files), json.dumps(document) + "\n", files=files)


def cache(request: Request) -> Outcome:
    """Return size, limit and last use of the compiled models on disk, or delete all of them."""
    import time

    from diagramc import cache_directory, cache_entries, cache_size_limit, clear_cache

    directory = cache_directory()
    origin = {"kneexo": __version__, "directory": str(directory)}
    if request.clear:
        count = clear_cache() + _clear_cache_of_before(directory)
        text = f"{directory}: {count} {'entry' if count == 1 else 'entries'} deleted\n"
        return Outcome(text, json.dumps({**origin, "deleted": count}) + "\n")
    entries, limit_bytes = cache_entries(), cache_size_limit()
    size_bytes = sum(entry.size_bytes for entry in entries)
    document = {
        **origin,
        "size_bytes": size_bytes,
        "limit_bytes": limit_bytes,
        "entries": [
            {
                "name": entry.path.name,
                "size_bytes": entry.size_bytes,
                "last_use_s": entry.last_use_s,
            }
            for entry in entries
        ],
    }
    lines = [
        f"directory  {directory}",
        f"entries    {len(entries)}",
        f"size       {size_bytes / 2**20:.1f} of at most {limit_bytes / 2**20:.0f} MiB",
    ]
    if entries:
        lines.append("used last")
    for entry in entries[:5]:  # the entries that were used last come first; --json has all
        last_use = time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.last_use_s))
        lines.append(f"  {last_use}  {entry.size_bytes / 2**10:8.1f} KiB  {entry.path.name}")
    return Outcome("\n".join(lines) + "\n", json.dumps(document, indent=2) + "\n")


def _clear_cache_of_before(directory: Path) -> int:
    """Delete the compiled models of kneexo 0.2 and before, and return their number.

    They stand in the folder that the user has chosen for the cache, or in kneexo beside diagramc.
    """
    name = re.compile(r"[0-9a-f]{32}\.kneexo")
    folders = [directory, directory.with_name("kneexo")]
    files = [file for folder in folders for file in folder.glob("*.kneexo")]
    old = [file for file in files if name.fullmatch(file.name)]
    for file in old:
        file.unlink(missing_ok=True)
    return len(old)
