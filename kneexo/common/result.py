"""Base class of results, and functions for their short texts and data frames."""

from __future__ import annotations

import base64
import io
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
_PICTURE_DPI = 60  # a plot 7 inches wide gets 420 pixels


class Result:
    """Base of the dataclasses of results. A subclass is a dataclass with ``repr=False``.

    ``repr`` shows each field in a few words, for example a number by its value and an array by its
    shape and range. A notebook shows what ``print`` shows, or a table of the fields if the class
    has no ``__str__``. Below it shows the picture of the method ``plot``, if any.
    """

    def __repr__(self) -> str:
        """Return one line with the class name, and the name and short text of each field."""
        values = ", ".join(f"{name}={text}" for name, text in _texts(self))
        return f"{type(self).__name__}({values})"

    def _repr_html_(self) -> str:
        """Return the text or table of the result, and its picture."""
        if type(self).__str__ is not object.__str__:
            shown = f"<pre style='white-space:pre-wrap'>{escape(str(self))}</pre>"
        else:
            shown = _table(self)
        return shown + _picture(self)


def _texts(result: Any) -> Iterable[tuple[str, str]]:
    """Yield name and short text of each field of a dataclass that belongs to its `repr`."""
    return ((f.name, short(getattr(result, f.name))) for f in fields(result) if f.repr)


def _table(result: Any) -> str:
    """Return an HTML table with a row for each field, and for each array in a dictionary."""
    rows = []
    for name, text in _texts(result):
        value = getattr(result, name)
        if isinstance(value, Mapping) and value and _are_arrays(value.values()):
            rows += [(column, short(values)) for column, values in value.items()]
        else:
            rows.append((name, text))
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td>{escape(text)}</td></tr>"
        for name, text in rows
    )
    return f"<table><caption>{type(result).__name__}</caption>{cells}</table>"


def _are_arrays(values: Iterable[Any]) -> bool:
    return all(isinstance(value, np.ndarray) for value in values)


def _picture(result: Any) -> str:
    """Return the plot of a result as an HTML image, or an empty text if it has no ``plot``."""
    if not hasattr(result, "plot"):
        return ""
    import matplotlib.pyplot as plt

    figure = np.ravel(result.plot())[0].figure
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=_PICTURE_DPI)
    plt.close(figure)  # a notebook would show the open figure a second time
    data = base64.b64encode(png.getvalue()).decode()
    return f'<img alt="{escape(figure.get_label())}" src="data:image/png;base64,{data}">'


def short(value: Any) -> str:
    """Return a short text for a value, such as an array's shape or a long tuple's length."""
    if isinstance(value, float | complex | np.floating):
        return f"{value:.6g}"
    if isinstance(value, np.ndarray):
        return f"array{value.shape}{_range(value)}"
    if isinstance(value, Mapping):
        names = ", ".join(str(name) for name in list(value)[:3])
        more = f", … {len(value)} names" if len(value) > 3 else ""
        return f"{{{names}{more}}}"
    text = repr(value)
    if len(text) <= _LONGEST:
        return text
    if isinstance(value, Result):
        return f"{type(value).__name__}(…)"
    if isinstance(value, tuple | list):
        return f"{len(value)} × {type(value[0]).__name__}"
    return f"{text[: _LONGEST - 1]}…"


def _range(values: Array) -> str:
    """Return the least and the largest of real numbers as text, or an empty text."""
    if values.dtype.kind not in "fiu" or not np.isfinite(values).any():
        return ""
    return f" {np.nanmin(values):.4g} … {np.nanmax(values):.4g}"


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
