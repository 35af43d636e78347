"""Files of the folder ``templates``, with their gaps filled."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from importlib import resources


def filled(
    template: str,
    names: Mapping[str, str],
    words: Mapping[str, str],
    blocks: Mapping[str, Sequence[str]],
    conditions: Collection[str],
) -> str:
    """A file of ``templates``.

    ``names`` replace the words in capitals, alone or as the beginning of an identifier. ``words``
    replace ``@{word}``, ``blocks`` the lines ``@block``. list[str] between ``@if`` and ``@end`` (or
    ``@else``) stay where the condition holds.
    """
    package = resources.files(__package__.rpartition(".")[0])
    text = package.joinpath(template).read_text("utf-8")
    pattern = re.compile(rf"(?<![A-Za-z_])({'|'.join(names)})(?=[U_]?\b|_)")
    lines: list[str] = []
    kept = [True]
    for line in text.splitlines():
        mark, _, condition = line.partition(" ")
        if mark == "@if":
            kept.append(condition in conditions)
        elif mark == "@else":
            kept[-1] = not kept[-1]
        elif mark == "@end":
            kept.pop()
        elif not all(kept):
            continue
        elif line.startswith("@") and line[1:] in blocks:
            lines += blocks[line[1:]]
        else:
            line = pattern.sub(lambda match: names[match[1]], line)
            lines.append(re.sub(r"@\{(\w+)\}", lambda match: words[match[1]], line))
    return "\n".join(lines)
