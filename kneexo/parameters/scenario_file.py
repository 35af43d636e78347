"""Read and write scenario files in YAML, and read files of uncertain values.

A file contains only the values that differ from the defaults. A faulty file raises `ScenarioError`,
whose message is one line with file, line, path, value, unit and range.

The files follow YAML 1.2 without some forms: no dates, no octal or hexadecimal numbers, no tags, no
merge keys. Depth of nesting and number of values are limited. PyYAML parses the files. ``_Loader``
adds these rules and finds the line of each path.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml
from pydantic import ValidationError
from pydantic.fields import FieldInfo
from yaml.reader import ReaderError

from kneexo.common.files.reading import MIB, file_error, read_text
from kneexo.errors import OutputError, ParameterError, ScenarioError, shortened, shown
from kneexo.parameters import (
    UNCERTAIN_KNEE,
    Law,
    Scenario,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.fields.fields import allowed_range, source_of, unit_of
from kneexo.parameters.fields.messages import one_line
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.presets import PRESETS, with_preset
from kneexo.parameters.scenario import require_scenario
from kneexo.parameters.uncertainty import require_applicable

_Path = tuple[str | int, ...]
_TAG = "tag:yaml.org,2002:"
_MOST_BYTES = MIB
_MOST_VALUES = 100_000  # read in two seconds; aliases can multiply a short text without end
_DEEPEST = 20


def load_scenario(
    path: str | os.PathLike[str], preset: str | None = None, *, without_law: bool = False
) -> Scenario:
    """Read a scenario from a YAML file. A preset gives the values that the file lacks.

    Parameters
    ----------
    path
        A regular file in UTF-8 of at most 1 MiB with at most 100 000 values. An empty file is the
        scenario of the preset.
    preset
        Name of the preset (`kneexo.parameters.presets.PRESETS`). If it is None, the entry
        ``preset`` of the file has the name; a file without this entry starts from the defaults.
    without_law
        True: leave out a law of the user, which the caller does not need or replaces, so that it
        may also be one that a file cannot name. Only its sample time and its limit are kept.

    Raises
    ------
    ScenarioError
        The file cannot be read or is not YAML, or an entry is unknown, missing, wrong or
        duplicate.
    ParameterError
        ``preset`` is no name of a preset.
    """
    name = os.fspath(path)
    data, lines = _read(name, read_text(name, _MOST_BYTES))
    entry = data.pop("preset", "paper")
    if preset is None:
        try:
            data = with_preset(entry, data)
        except ParameterError as error:
            raise file_error(name, _line(lines, ("preset",)), str(error)) from None
    else:
        data = with_preset(preset, data)
    law = data.get("controller")
    if without_law and isinstance(law, Mapping) and law.get("kind") == "law":
        kept = law.keys() & {"sample_time_s", "command_limit_rad_s"}
        data = {**data, "controller": {name: law[name] for name in kept}}
    try:
        validator = Scenario.__pydantic_validator__
        scenario: Scenario = validator.validate_python(
            data, context={"directory": Path(name).parent}
        )
        return scenario
    except ValidationError as error:
        location, message = one_line(Scenario, error)
    raise file_error(name, _line(lines, location), message)


def as_scenario(
    scenario: Scenario | str | os.PathLike[str],
    law: Any = None,
    initial_state: Sequence[float] = (),
) -> Scenario:
    """Return ``scenario``, or the scenario that `load_scenario` reads if it is the path of a file.

    ``law`` replaces the control law of the scenario: see `Scenario.with_law`.
    Raises `ParameterError` if ``scenario`` has another type, and the errors of `load_scenario`.
    """
    if isinstance(scenario, str | os.PathLike):
        if scenario in PRESETS and not os.path.exists(scenario):
            require_scenario(scenario)
        scenario = load_scenario(scenario)
    require_scenario(scenario)
    return scenario if law is None else scenario.with_law(law, initial_state=initial_state)


def load_uncertainty(
    path: str | os.PathLike[str], scenario: Scenario = UNCERTAIN_KNEE
) -> UncertaintySet:
    """Read uncertain values from a YAML file that maps a dotted path to an `Uncertainty`.

    .. code-block:: yaml

        plant.cylinder.mass_kg: {low: 1.4, high: 1.8}
        plant.pump.lag_s: {low: 0.005, high: 0.02, scale: log}
        plant.linkage: {options: [G1, G2, G3], known: true}

    The result can have paths that ``scenario`` lacks but another scenario has. `applicable`
    removes these paths.

    Raises
    ------
    ScenarioError
        The file cannot be read, is not YAML or is empty, or an entry is unknown, wrong, duplicate
        or out of range.
    """
    name = os.fspath(path)
    data, lines = _read(name, read_text(name, _MOST_BYTES))
    if not data:
        raise file_error(name, None, "has no uncertain values")
    values = {}
    for place, value in data.items():
        if not isinstance(value, dict):
            message = f"{place}: must be {{low: …, high: …}} or {{options: […]}}"
            raise file_error(name, lines[place,], message)
        if any(isinstance(part, dict) for part in value.values()):
            message = f"{place}: must be a dotted path, such as plant.cylinder.mass_kg"
            raise file_error(name, lines[place,], message)
        parts = [part for part in value.get("options") or () if isinstance(part, dict)]
        names_code = re.fullmatch(r"controller\.function|parts\.\w+(\.make)?", place)
        if names_code or any({"function", "make"} & part.keys() for part in parts):
            message = f"{place}: must name no law; vary its gains, such as controller.values.gain"
            raise file_error(name, lines[place,], message)
        try:
            values[place] = Uncertainty.__pydantic_validator__.validate_python(value)
            require_applicable(scenario, place, values[place], data)
        except ValidationError as error:
            location, message = one_line(Uncertainty, error)
            separator = "." if location else ": "
            line = _line(lines, (place, *location))
            raise file_error(name, line, f"{place}{separator}{message}") from None
        except ParameterError as error:
            raise file_error(name, lines[place,], str(error)) from None
    return UncertaintySet(values=values)


def dump_scenario(scenario: Scenario) -> str:
    """Return all values of a scenario as YAML text. Comments have unit and range, or the choices.

    Floats have all their digits, so `load_scenario` reads an equal scenario from the text.
    """
    return "\n".join(_dumped(scenario, "")) + "\n"


def scenario_files(
    scenario: Scenario, name: str, folder: Path | None = None
) -> dict[str, str | bytes]:
    """Return a scenario file called ``name``, and the user's Python that lies beside it.

    So the folder repeats the run, also elsewhere. If ``folder``, where the files are to lie, is the
    folder of a law or part, its files are there already. Raises `OutputError` if the folder has
    another file in place of one of these, and no scenario file of an earlier run: a user's own
    code.
    """
    others: dict[str, str | bytes] = {}
    for path, code in scenario.users_code().items():
        if not code.sources:
            continue
        file = next(iter(code.sources))
        is_there = folder is not None and code.file == Path(folder, file).resolve()
        if folder is not None and not is_there and not Path(folder, name).exists():
            for source, content in code.sources.items():
                other = Path(folder, source)
                if other.exists() and not (other.is_file() and other.read_bytes() == content):
                    raise OutputError(
                        f"--out {shown(folder)}: has another {source} than {code.subject}; choose "
                        f"a new folder"
                    )
        copy = type(code)(code.target, f"{file}:{code.name.rpartition(':')[2]}")
        scenario = scenario.changed({path: copy})
        others |= {} if is_there else code.sources
    return {name: dump_scenario(scenario), **others}


def read_value(name: str, text: str) -> Any:
    """Return the value of a YAML text: a scalar, a tuple (from a list) or a mapping.

    Raises `ScenarioError` if the text is not YAML or has more than one value. The message calls
    the text ``name``.
    """
    data, _ = _read(name, f"value: {text}")
    if list(data) != ["value"]:
        raise ScenarioError(f"{shown(name)}: must be a single value, not more lines of YAML")
    return data["value"]


_TOO_MUCH = (
    f"too deep or too many values (aliases?): must have at most {_DEEPEST} levels and "
    f"{_MOST_VALUES} values"
)


class _Loader(yaml.SafeLoader):
    """PyYAML loader that reads ``1e5`` as a number, and ``on``, ``1:30`` and dates as text.

    ``name`` stands for the text in error messages.
    """

    def __init__(self, name: str, text: str) -> None:
        super().__init__(text)
        self.name = name
        self.lines: dict[_Path, int] = {}
        self._composed, self._depth = 0, 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a node of the YAML tree. Raise `ScenarioError` for too many nodes or levels."""
        self._composed += 1
        self._depth += 1
        if self._depth > _DEEPEST + 1 or self._composed > 2 * _MOST_VALUES:
            # PyYAML's stubs leave peek_event() untyped.
            line = self.peek_event().start_mark.line + 1  # type: ignore[no-untyped-call]
            raise file_error(self.name, line, _TOO_MUCH)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def error(self, node: yaml.Node, path: _Path, message: str) -> ScenarioError:
        """Return an error whose message names file, line and path of a YAML node."""
        where = f"{_dotted(path)}: " if path else ""
        return file_error(self.name, node.start_mark.line + 1, where + message)

    def plain(self, node: yaml.Node, path: _Path) -> Any:
        """Convert a YAML node to dictionaries, tuples and scalars.

        Stores the line of each path in ``lines``. Raises `ScenarioError` for a YAML tag, for a
        mapping's key that is not text, for a duplicate key, and for too many levels or values.
        """
        self.lines.setdefault(path, node.start_mark.line + 1)
        if len(path) > _DEEPEST or len(self.lines) > _MOST_VALUES:
            raise self.error(node, path, _TOO_MUCH)
        quoted = isinstance(node, yaml.ScalarNode) and node.style is not None
        # PyYAML's stubs leave resolve() untyped.
        implied = self.resolve(type(node), node.value, (not quoted, quoted))  # type: ignore[no-untyped-call]
        if node.tag != implied:
            raise self.error(node, path, f"tag {shortened(node.tag)!r} is not supported")
        if isinstance(node, yaml.ScalarNode):
            return self.construct_object(node)
        if isinstance(node, yaml.SequenceNode):
            return tuple(self.plain(item, (*path, n)) for n, item in enumerate(node.value))
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = key_node.value
            if not isinstance(key_node, yaml.ScalarNode) or key_node.tag != f"{_TAG}str":
                kind = shortened(key or "null") if isinstance(key, str) else "a list or mapping"
                comma = key_node.tag == f"{_TAG}int" and not value_node.value
                advice = "; write a decimal point in numbers" if comma else ""
                raise self.error(key_node, path, f"a name must be text, not {kind}{advice}")
            at = (*path, key)
            if first := self.lines.get(at):
                raise self.error(key_node, at, f"duplicate name, first on line {first}")
            self.lines[at] = key_node.start_mark.line + 1
            data[key] = self.plain(value_node, at)
        return data


_Loader.yaml_implicit_resolvers = {}  # in place of those of SafeLoader
for _kind, _pattern in {
    "null": r"|~|null|Null|NULL",
    "bool": r"true|True|TRUE|false|False|FALSE",
    "int": r"[-+]?(0|[1-9][0-9]{0,17})",  # with more digits, a float
    "float": r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
    r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
}.items():
    _Loader.add_implicit_resolver(f"{_TAG}{_kind}", re.compile(rf"(?:{_pattern})\Z"), None)


def _line(lines: Mapping[_Path, int], location: _Path) -> int:
    """Return the line of a path. If the file lacks the path, return its nearest parent's line."""
    while location not in lines:
        location = location[:-1]
    return lines[location]


def _read(name: str, text: str) -> tuple[dict[str, Any], dict[_Path, int]]:
    """Return the top-level mapping of a YAML text, and the line of each path.

    A text without content gives an empty mapping. Raises `ScenarioError` if the text is not YAML
    or its top level is no mapping. The message calls the text ``name``.
    """
    try:
        loader = _Loader(name, text)
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        problem = ", ".join(part for part in (error.context, error.problem) if part)
        mark = error.problem_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        raise file_error(name, line, f"YAML syntax, column {column}: {problem}") from None
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise file_error(
            name, line, f"YAML syntax: {text[error.position]!a}: {error.reason}"
        ) from None
    except (
        ArithmeticError,
        ValueError,
        RecursionError,
    ) as error:  # wrong \U or %YAML, nesting
        raise file_error(name, None, f"YAML syntax: {error}") from None
    if root is None or (data := loader.plain(root, ())) is None:
        return {}, loader.lines
    if not isinstance(data, dict):
        kind = "a list" if isinstance(data, tuple) else "a single value"
        raise file_error(name, loader.lines[()], f"the top level must be a mapping, not {kind}")
    return data, loader.lines


def _dumped(parameters: Parameters, indent: str) -> Iterator[str]:
    """Yield the YAML lines of ``parameters``. Nested parameters are indented by two more spaces."""
    for name, field in type(parameters).model_fields.items():
        value = vars(parameters)[name]  # a replaced number too
        notes = (_note(field), source_of(field) if value is None else "")
        comment = f"  # {note}" if (note := "; ".join(filter(None, notes))) else ""
        if isinstance(value, Parameters):
            yield f"{indent}{name}:{comment}"
            yield from _dumped(value, indent + "  ")
        else:
            yield f"{indent}{name}: {_text_of(value)}{comment}"


def _text_of(value: Any) -> str:
    """Return a value as YAML text. A float such as 1e-8 becomes 1.0e-8, as YAML 1.1 requires."""
    if isinstance(value, Parameters):
        value = {name: item for name, item in vars(value).items() if item is not None}
    if isinstance(value, tuple):
        return f"[{', '.join(map(_text_of, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(k)}: {_text_of(v)}' for k, v in value.items())}}}"
    if isinstance(value, str):
        return value
    if isinstance(value, Law):
        return json.dumps(value.written, ensure_ascii=False)  # a path may have spaces or colons
    return re.sub(r"(?<![.\d])(\d+)e", r"\1.0e", json.dumps(value))


def _note(field: FieldInfo) -> str:
    """Return the text of a comment on a field.

    The text lists the kinds of a union or the choices of a literal, else it has unit and range.
    """
    options = get_args(field.annotation)
    if field.discriminator:
        return "kind: " + ", ".join(member.model_fields["kind"].default for member in options)
    if get_origin(field.annotation) is Literal and len(options) > 1:
        return ", ".join(str(option) for option in options)
    return ", ".join(part for part in (unit_of(field), allowed_range(field)) if part)


def _dotted(path: _Path) -> str:
    return shortened(".".join(str(key) for key in path))
