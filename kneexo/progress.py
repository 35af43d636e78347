"""Progress bar with the remaining time, for terminals and notebooks."""

from __future__ import annotations

import builtins
import importlib.util
from typing import Any

from tqdm import tqdm

_FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}, {remaining} left"


def progress_bar(total: float, description: str | None) -> Any:
    """Return a bar of tqdm that ends at ``total``; its method ``update(amount)`` advances it.

    The bar shows nothing if ``description`` is None, or if stderr is no terminal. In a notebook the
    bar requires ipywidgets (``pip install "kneexo[notebook]"``) and otherwise shows nothing.
    """
    settings: dict[str, Any] = {
        "total": total,
        "desc": description,
        "mininterval": 0.5,
        "bar_format": _FORMAT,
    }
    if description is not None and _in_notebook() and importlib.util.find_spec("ipywidgets"):
        from tqdm.notebook import tqdm as notebook_bar

        return notebook_bar(**settings)
    return tqdm(**settings, disable=True if description is None else None)


def _in_notebook() -> bool:
    """Return whether a Jupyter kernel runs this code.

    IPython adds the function ``get_ipython`` to the builtins.
    """
    shell = getattr(builtins, "get_ipython", None)
    return shell is not None and "IPKernelApp" in shell().config
