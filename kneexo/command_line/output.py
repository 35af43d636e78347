"""Writes results as JSON, signals as CSV, and figures as PNG and PDF."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kneexo.simulation.run import Run


def plain(value: Any) -> Any:
    """Return ``value`` as data for JSON: arrays become lists, nan and infinity become None."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(value: Any) -> str:
    """Return ``value``, converted by `plain`, as JSON text, indented by two spaces."""
    return json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def write_csv(path: Path, run: Run) -> None:
    """Write all signals of a run to a CSV file. The name of a column ends with its unit."""
    line = ",".join(["%.10g"] * len(run.columns)) + "\n"
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(run.columns) + "\n")
        file.writelines(line % row for row in zip(*run.columns.values(), strict=True))


def svg_text(figure: Figure) -> str:
    """Return a figure as SVG without a date, so that equal figures give equal text."""
    import matplotlib as mpl

    stream = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "kneexo"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)


def words_of(figure: Figure) -> str:
    """Return the words of a figure, one text a line: caption, titles, labels and legends."""
    from matplotlib.legend import Legend

    words = [str(figure.get_label()), figure.get_suptitle()]
    for ax in figure.axes:
        words += [ax.get_title("left"), ax.get_title(), ax.get_title("right")]
        words += [ax.get_xlabel(), ax.get_ylabel()]
    for legend in figure.findobj(Legend):
        words += [text.get_text() for text in legend.get_texts()]
    return "\n".join(filter(None, words))


def save_figure(directory: Path, name: str, figure: Figure) -> None:
    """Write a figure as NAME.png and NAME.pdf without dates, so equal figures give equal files.

    The PNG has `words_of` the figure as ``Description``.
    """
    description = {"Description": words_of(figure)}
    figure.savefig(directory / f"{name}.png", dpi=150, metadata=description)
    figure.set_layout_engine(None)  # the layout is complete; an engine would draw each file twice
    figure.savefig(directory / f"{name}.pdf", metadata={"CreationDate": None})
