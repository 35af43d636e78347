"""Base class of results, and functions for their short texts and data frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kneexo.errors import PackageError

Array = NDArray[np.float64]
"""Type of a numpy array of doubles."""

_LONGEST = 60  # characters of one value


class Result:
    """Base of the dataclasses of results. A subclass is a dataclass with ``repr=False``.

    ``repr`` shows each field in a few words, for example a number by its value and an array by its
    shape. A notebook shows the same texts in a table.
    """

    def __repr__(self) -> str:
        """Return one line with the class name, and the name and short text of each field."""
        values = ", ".join(f"{name}={text}" for name, text in _texts(self))
        return f"{type(self).__name__}({values})"

    def _repr_html_(self) -> str:
        """Return an HTML table with a row for each field."""
        rows = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th><td>{escape(text)}</td></tr>"
            for name, text in _texts(self)
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"


def _texts(result: Any) -> Iterable[tuple[str, str]]:
    """Yield name and short text of each field of a dataclass that belongs to its `repr`."""
    return ((f.name, short(getattr(result, f.name))) for f in fields(result) if f.repr)


def short(value: Any) -> str:
    """Return a short text for a value, such as an array's shape or a long tuple's length."""
    if isinstance(value, float | complex | np.floating):
        return f"{value:.6g}"
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    if isinstance(value, Mapping):
        return _counted(value, "{", "}")
    text = repr(value)
    if len(text) <= _LONGEST:
        return text
    if isinstance(value, Result):
        return f"{type(value).__name__}(…)"
    if isinstance(value, tuple | list):
        return f"{len(value)} × {type(value[0]).__name__}"
    return f"{text[: _LONGEST - 1]}…"


def _counted(value: Mapping[Any, Any], left: str, right: str) -> str:
    """Return the first three names of a mapping, and the number of names if there are more."""
    names = ", ".join(str(name) for name in list(value)[:3])
    more = f", … {len(value)} names" if len(value) > 3 else ""
    return f"{left}{names}{more}{right}"


def data_frame(columns: Mapping[str, Any], index: str | None = None) -> Any:
    """Return a `pandas.DataFrame`. ``columns`` maps the name of a column to its values (n,).

    ``index`` is the name of the column that becomes the index. Raises `PackageError` when pandas is
    not installed.
    """
    try:
        import pandas
    except ImportError:
        raise PackageError("to_dataframe needs pandas: pip install pandas") from None
    frame = pandas.DataFrame(dict(columns))
    return frame if index is None else frame.set_index(index)
