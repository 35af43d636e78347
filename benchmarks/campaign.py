"""Kill and damage what kneexo does and keeps, and give it random scenarios.

Nothing may be lost, no number may be wrong, and nothing may end in a traceback, a hang or a nan.

    python benchmarks/campaign.py [--seed N] [--count N] [PART ...]

``kills``: sweeps, ``simulate`` and ``reproduce`` are killed at random times by SIGKILL, SIGTERM or
SIGINT, most sweeps twice. After each kill no process may be left for longer than 5 s, no finished
piece may be lost, and there must be no traceback (SIGKILL: other processes may have one). The next
run must delete what was left and write the bytes of a run that nobody interrupted.

``sweeps``: the same for sweeps with two workers, after a random number of pieces is finished. There
are three more attacks: the kill of a worker, a full disk (requires the right to mount a tmpfs) and
a limit of the file's size. The command must end with one line that names the cause.

``damage``: files of the cache and checkpoints are damaged. A run must write the same bytes, or say
in one line what is wrong, without a traceback.

``files``, ``linear``, ``corners``, ``random``: see ``campaign_scenarios.py``.

``inputs``: CSV files, controller modules, folders of results and special files; see
``campaign_inputs.py``.

``--count``: cases of each part. The same seed gives the same cases; where a kill hits depends on
the machine. Prints a table with counts, and each violation; exit code 1 if there is any.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

SCENARIO = "simulation: {duration_s: 2.0}\n"
FEW = ["--set", "frequencies_hz=[2, 3, 5, 8]"]
COMMANDS = {
    "bandwidth": [
        *("study", "bandwidth", "--workers", "2", *FEW),
        *("--set", "amplitudes_deg=[0.5, 1, 2, 4]"),
    ],
    "bandwidth, 1 worker": [
        *("study", "bandwidth", "--workers", "1", *FEW, "--set", "amplitudes_deg=[1, 3]"),
    ],
    "robustness": [
        *("study", "robustness", "--workers", "2", "--set", "samples=20"),
        *("--set", "corners_max=10"),
        *("--set", "bandwidth=false", "--set", "sensitivity_duration_s=0"),
    ],
    "contest": [
        *("study", "contest", "--workers", "2", "--set", "test_samples=12"),
        *("--set", "training_samples=2", "--set", "population=5", "--set", "generations=2"),
        *("--set", "optimizer_seeds=[1]"),
    ],
    "simulate": ["simulate", "scenario.yaml"],
    "reproduce": ["reproduce", "--workers", "2"],
}
SWEEPS = ("bandwidth", "robustness", "contest")
DAMAGED = COMMANDS["bandwidth, 1 worker"]
SIGNALS = {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}
ORPHANS_S = 5.0

Process = subprocess.Popen[bytes]


@dataclass
class Part:
    """What a part of the campaign counted."""

    folder: Path
    random: random.Random
    count: int
    counts: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)

    def require(self, holds: bool, case: str, what: str) -> None:
        """Note a violation where ``holds`` is false."""
        if not holds:
            self.counts["violations"] += 1
            self.violations.append(f"{case}: {what}")
            print(f"  {case}: {what}", flush=True)


@dataclass(frozen=True)
class Ended:
    """A command that has ended."""

    code: int
    error: str
    seconds: float
    orphans: int
    """Its processes that were alive 5 s later; they are killed."""


# ------------------------------------------------------------------------------ processes


def alive(session: int) -> list[int]:
    """Processes of a session that still work."""
    numbers = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, of = file.read_text().rpartition(")")[2].split()[:4]
        except OSError:  # it has just ended
            continue
        if int(of) == session and state != "Z":
            numbers.append(int(file.parent.name))
    return numbers


def run(
    part: Part,
    command: Sequence[str],
    out: Path,
    attack: Callable[[Process], object] | None = None,
) -> Ended:
    """Run a command in the part's folder, and attack its process."""
    begin = time.monotonic()
    temporary = part.folder / "tmp"
    temporary.mkdir(exist_ok=True)
    folders = {"KNEEXO_CACHE_DIR": str(part.folder / "cache"), "TMPDIR": str(temporary)}
    with (part.folder / "error").open("w+") as error:
        process = subprocess.Popen(
            [sys.executable, "-m", "kneexo", *command, "--out", str(out)],
            cwd=part.folder,
            env=os.environ | folders,
            stdout=subprocess.DEVNULL,
            stderr=error,
            start_new_session=True,
        )
        try:
            if attack is not None:
                attack(process)
            process.wait()
            seconds = time.monotonic() - begin
            end = time.monotonic() + ORPHANS_S
            while (left := alive(process.pid)) and time.monotonic() < end:
                time.sleep(0.05)
        finally:  # also when the campaign itself is interrupted
            for orphan in alive(process.pid):
                with suppress(ProcessLookupError):
                    os.kill(orphan, signal.SIGKILL)
        error.seek(0)
        return Ended(process.returncode, error.read(), seconds, len(left))


def send(process: Process, number: signal.Signals) -> None:
    """Send a signal, unless the process has ended."""
    if number == signal.SIGINT:  # a terminal sends it to all processes
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
    else:
        process.send_signal(number)


def send_after(number: signal.Signals, after_s: float, process: Process) -> None:
    """Send a signal after ``after_s`` seconds."""
    with suppress(subprocess.TimeoutExpired):
        process.wait(after_s)
    send(process, number)


def results(out: Path) -> dict[str, bytes]:
    """The files of a directory, without hidden ones and checkpoints."""
    files = sorted(out.iterdir()) if out.exists() else []
    return {
        file.name: file.read_bytes()
        for file in files
        if file.is_file() and not file.name.endswith(".checkpoint.jsonl")
    }


def last_line(ended: Ended) -> str:
    """What a command said at its end."""
    return (ended.error.strip().splitlines() or [""])[-1]


# ---------------------------------------------------------------------------------- kills


def kills(part: Part) -> None:
    """See the docstring of this file."""
    (part.folder / "scenario.yaml").write_text(SCENARIO)
    whole: dict[str, tuple[dict[str, bytes], float]] = {}
    for case in range(part.count):
        name = part.random.choice(list(COMMANDS))
        if name not in whole:
            for _ in range(2):  # the first one compiles
                ended = run(part, COMMANDS[name], part.folder / name)
                part.require(ended.code == 0, name, last_line(ended))
            whole[name] = results(part.folder / name), ended.seconds
        expected, seconds = whole[name]
        out = part.folder / f"case {case}"
        for _ in range(part.random.choice((1, 2))):
            number = part.random.choice(list(SIGNALS))
            after_s = part.random.uniform(0.02, seconds)
            attack = partial(send_after, number, after_s)
            label = f"{name}, after {after_s:.2f} s"
            _attacked(part, name, out, number.name, SIGNALS[number], attack, expected, label)
        _again(part, name, out, expected)
        shutil.rmtree(out)


def _attacked(
    part: Part,
    name: str,
    out: Path,
    kind: str,
    code: int,
    attack: Callable[[Process], object],
    expected: dict[str, bytes],
    label: str,
) -> None:
    """Run a command of `COMMANDS` under an attack, which must end it with exit code ``code``."""
    label = f"{out.name} {kind} {label}"
    pieces, before = _checkpoint(out), set(out.glob(".kneexo-*"))
    ended = run(part, COMMANDS[name], out, attack)
    part.counts[kind] += 1
    part.require(not ended.orphans, label, f"{ended.orphans} processes after {ORPHANS_S:g} s")
    now = _checkpoint(out)
    if ended.code == 0:
        part.counts["ended before"] += 1
    else:
        complete = now.startswith(pieces) or results(out) == expected
        part.require(complete, label, "finished pieces are lost")
        part.counts["pieces kept"] += now.count(b"\n")
    part.require(results(out) in ({}, expected), label, "not all files or none")
    if kind == "SIGKILL" or ended.code == 0:
        return
    # Python itself had not yet begun, or has already ended: there is nothing, or everything.
    quiet = results(out) == expected or not list(out.glob("*"))
    outside = code > 128 and ended.code == 128 - code and quiet
    part.counts["before or after Python code"] += outside
    # What an earlier SIGKILL left goes when a run gets as far as its output.
    temporary = set(out.glob(".kneexo-*")) - before
    part.require(not temporary, label, "a temporary directory is left")
    if outside:
        return
    part.require(ended.code == code, label, f"exit code {ended.code}: {last_line(ended)}")
    part.require("Traceback" not in ended.error, label, f"traceback: {ended.error[-1500:]}")
    line = last_line(ended)
    part.require(line.startswith("kneexo: "), label, f"said {line!r}")
    phrases = ("kept in", "are kept", "results are in", "interrupted", "cannot write")
    part.require(not now or any(text in line for text in phrases), label, f"said {line!r}")


def _again(part: Part, name: str, out: Path, expected: dict[str, bytes]) -> None:
    """Run a command again after attacks. It must write the bytes of an undisturbed run."""
    label = f"{out.name} {name}, again"
    ended = run(part, COMMANDS[name], out)
    part.require(ended.code == 0, label, last_line(ended))
    part.require(not ended.orphans, label, f"{ended.orphans} processes after {ORPHANS_S:g} s")
    part.require(results(out) == expected, label, "other bytes")
    names = {file.name for file in out.iterdir()}
    part.require(names == set(expected), label, f"leftovers {names}")
    leftovers = sorted(file.name for file in (part.folder / "tmp").iterdir())
    part.require(not leftovers, label, f"temporary files {leftovers}")
    part.counts["runs compared"] += 1


def _checkpoint(out: Path) -> bytes:
    data = b""
    for file in out.glob("*.checkpoint.jsonl"):
        with suppress(FileNotFoundError):  # it has just been deleted
            data += file.read_bytes()
    return data


# --------------------------------------------------------------------------------- sweeps


@dataclass(frozen=True)
class Undisturbed:
    """A sweep that nobody interrupts."""

    files: dict[str, bytes]
    pieces: int


def sweeps(part: Part) -> None:
    """See the docstring of this file; ``count`` is that of the attacks."""
    disk = part.folder / "disk"
    disk.mkdir()
    kinds = [number.name for number in SIGNALS] + ["SIGKILL of a worker", "file size limit"]
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=32m", "none", disk]).returncode == 0:
        kinds.append("full disk")
    try:
        whole = {name: _undisturbed(part, name) for name in SWEEPS}
        number = 0
        while number < part.count:
            name = SWEEPS[part.counts["runs compared"] % len(SWEEPS)]
            out = disk / f"case {part.counts['runs compared']}"
            for _ in range(min(part.random.choice((1, 2, 3)), part.count - number)):
                _attack_within(part, name, out, kinds[number % len(kinds)], whole[name])
                number += 1
            _again(part, name, out, whole[name].files)
            shutil.rmtree(out)
    finally:
        if "full disk" in kinds:
            subprocess.run(["umount", "--lazy", disk], check=True)


def _undisturbed(part: Part, name: str) -> Undisturbed:
    """Run a sweep and count its pieces."""
    out, pieces = part.folder / name, 0

    def watch(process: Process) -> None:
        nonlocal pieces
        while process.poll() is None:
            pieces = max(pieces, _pieces(out))
            time.sleep(0.02)

    ended = run(part, COMMANDS[name], out, watch)
    part.require(ended.code == 0, name, last_line(ended))
    return Undisturbed(results(out), pieces)


def _attack_within(part: Part, name: str, out: Path, kind: str, whole: Undisturbed) -> None:
    """Attack a sweep after a random number of its pieces is finished."""
    finished = min(_pieces(out), whole.pieces - 1)  # not counting a line that a full disk cut
    pieces = part.random.randint(finished + 1, whole.pieces)
    pause_s, room = part.random.uniform(0.0, 0.3), part.random.randint(1, 4000)
    filler, before = out.parent / "filler", set(out.glob(".kneexo-*"))

    def attack(process: Process) -> None:
        # The run is at work when it has a workspace. Its pieces may be those of earlier runs.
        while process.poll() is None and not (
            _pieces(out) >= pieces and set(out.glob(".kneexo-*")) - before
        ):
            time.sleep(0.02)
        with suppress(subprocess.TimeoutExpired):
            process.wait(pause_s)
        with suppress(ProcessLookupError):  # it has just ended
            if kind == "full disk":
                with suppress(OSError), filler.open("wb", buffering=0) as file:
                    while True:
                        file.write(bytes(4096))
            elif kind == "file size limit":
                size = len(_checkpoint(out)) + room
                resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, size))
            elif kind == "SIGKILL of a worker":
                for worker in _workers(process.pid)[:1]:  # none while it writes its results
                    os.kill(worker, signal.SIGKILL)
            else:
                send(process, signal.Signals[kind])

    code = {number.name: code for number, code in SIGNALS.items()}.get(kind, 2)
    label = f"{name}, {pieces} of {whole.pieces} pieces"
    _attacked(part, name, out, kind, code, attack, whole.files, label)
    filler.unlink(missing_ok=True)


def _pieces(out: Path) -> int:
    """Number of lines of the checkpoint after its header."""
    return max(0, _checkpoint(out).count(b"\n") - 1)


def _workers(session: int) -> list[int]:
    """The worker processes of a session."""
    numbers = []
    for number in alive(session):
        with suppress(OSError):  # it has just ended
            if b"spawn_main" in Path(f"/proc/{number}/cmdline").read_bytes():
                numbers.append(number)
    return numbers


# --------------------------------------------------------------------------------- damage


def _flip(data: bytearray, chance: random.Random) -> bytearray:
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return data


def _digit(data: bytearray, chance: random.Random) -> bytearray:
    places = [i for i, byte in enumerate(data) if chr(byte).isdigit()]
    place = chance.choice(places)
    data[place] = chance.choice([d for d in b"0123456789" if d != data[place]])
    return data


def _cut(data: bytearray, chance: random.Random) -> bytearray:
    return data[: chance.randrange(len(data))]


def _zeros(data: bytearray, chance: random.Random) -> bytearray:
    start = chance.randrange(len(data))
    size = min(chance.choice((1, 16, 512, 4096)), len(data) - start)
    data[start : start + size] = bytes(size)
    return data


def _remove(data: bytearray, chance: random.Random) -> bytearray:
    start = chance.randrange(len(data))
    del data[start : start + chance.choice((1, 16, 512))]
    return data


def _twice(data: bytearray, chance: random.Random) -> bytearray:
    start, end = sorted(chance.randrange(len(data)) for _ in range(2))
    return data[:end] + data[start:]


def _insert(data: bytearray, chance: random.Random) -> bytearray:
    texts = (b"[" * 100_000, b"\n", b"\xff" * 9, b"null\n", b'["a", 1]\n', chance.randbytes(99))
    start = chance.randrange(len(data))
    return data[:start] + chance.choice(texts) + data[start:]


def _other(data: bytearray, chance: random.Random) -> bytearray:
    return bytearray(chance.choice((b"", b"\n", b"{}", b"my notes\n", chance.randbytes(len(data)))))


WAYS: list[Callable[[bytearray, random.Random], bytearray]]
WAYS = [_flip, _digit, _cut, _zeros, _remove, _twice, _insert, _other]


def damage(part: Part) -> None:
    """See the docstring of this file."""
    expected = _whole(part)
    cache, checkpoint = _kept(part)
    for case in range(part.count):
        way = WAYS[case % len(WAYS)]
        for kind in ("cache", "checkpoint"):
            out = part.folder / "out"
            out.mkdir()
            label = f"{case} {kind} {way.__name__.strip('_')}"
            for path, data in cache.items():
                broken = way(bytearray(data), part.random) if kind == "cache" else data
                path.write_bytes(broken)
            data = checkpoint
            if kind == "checkpoint":
                data = bytes(way(bytearray(checkpoint), part.random))
                (out / "bandwidth.checkpoint.jsonl").write_bytes(data)
            ended = run(part, DAMAGED, out)
            part.counts[f"{kind} damaged"] += 1
            part.require("Traceback" not in ended.error, label, ended.error[-1500:])
            part.counts["skipped or made anew, as said"] += "kneexo: " in ended.error
            part.require(ended.code == 0, label, f"{ended.code}: {last_line(ended)}")
            part.require(results(out) == expected, label, "other bytes")
            part.counts["runs compared"] += 1
            shutil.rmtree(out)


def _whole(part: Part) -> dict[str, bytes]:
    ended = run(part, DAMAGED, part.folder / "whole")
    part.require(ended.code == 0, "whole run", last_line(ended))
    return results(part.folder / "whole")


def _kept(part: Part) -> tuple[dict[Path, bytes], bytes]:
    """The files of the cache, and the checkpoint of a sweep that was killed."""
    cache = {file: file.read_bytes() for file in (part.folder / "cache").glob("*.kneexo")}
    after_s = 0.5
    while True:
        out = part.folder / "killed"
        run(part, DAMAGED, out, partial(send_after, signal.SIGKILL, after_s))
        checkpoint = _checkpoint(out)
        shutil.rmtree(out, ignore_errors=True)
        if checkpoint.count(b"\n") > 5:
            return cache, checkpoint
        after_s = 0.5 if after_s > 30.0 else after_s + 0.1


# ------------------------------------------------------------------------------- campaign


def _scenarios(name: str, part: Part) -> None:
    import campaign_scenarios  # beside this file; needs Drake

    seed = part.random.randrange(2**32)
    _count(part, campaign_scenarios.outcomes(name, part.count, seed), campaign_scenarios.BAD)


def _inputs(part: Part) -> None:
    import campaign_inputs  # beside this file; needs Drake

    seed = part.random.randrange(2**32)
    _count(part, campaign_inputs.inputs(part.count, seed), campaign_inputs.BAD)


def _count(part: Part, outcomes: Iterator[tuple[str, str, str]], bad: Sequence[str]) -> None:
    """Count cases by outcome; those of ``bad`` are violations."""
    for kind, message, text in outcomes:
        part.counts["cases"] += 1
        part.counts[kind] += 1
        part.require(kind not in bad, kind, f"{message}\n{text}")


PARTS: dict[str, tuple[Callable[[Part], None], int]] = {
    "kills": (kills, 100),
    "sweeps": (sweeps, 60),
    "damage": (damage, 100),
    "files": (partial(_scenarios, "files"), 10_000),
    "linear": (partial(_scenarios, "linear"), 0),
    "corners": (partial(_scenarios, "corners"), 0),
    "random": (partial(_scenarios, "random"), 5_000),
    "inputs": (_inputs, 3_000),
}
"""Each gets a folder, a random generator and the number of cases, and counts what it does; and the
number of cases by default."""


def campaign(names: Sequence[str], seed: int, count: int | None) -> Iterator[tuple[str, Part]]:
    """Run the parts of these names."""
    for name in names:
        function, usual = PARTS[name]
        with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
            part = Part(Path(folder), random.Random(f"{name} {seed}"), count or usual)
            try:
                function(part)
            except KeyboardInterrupt:
                part.counts["interrupted"] += 1
        yield name, part


def main() -> int:
    """Run the campaign; 1 if something was violated."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, help="cases of each part")
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"PART = {', '.join(unknown)}: must be of {', '.join(PARTS)}")
    # A shell makes what it starts in the background ignore SIGINT; our commands must not.
    for number in (signal.SIGINT, signal.SIGTERM):  # the table shows what was counted until then
        signal.signal(number, signal.default_int_handler)
    violations = 0
    print(f"seed {options.seed}\n| part | what | count |\n|---|---|---|")
    for name, part in campaign(options.parts or list(PARTS), options.seed, options.count):
        part.counts["violations"] += 0
        for what, count in sorted(part.counts.items()):
            print(f"| {name} | {what} | {count} |", flush=True)
        violations += len(part.violations)
    return int(violations > 0)


if __name__ == "__main__":
    sys.exit(main())
