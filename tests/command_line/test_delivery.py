import fcntl
import sys
import warnings

import pytest

from kneexo.command_line.delivery import deliver
from kneexo.command_line.main import main
from kneexo.command_line.outcome import Outcome
from kneexo.command_line.request import Request
from kneexo.common.interruption import Terminated
from kneexo.errors import WorkerError


@pytest.mark.parametrize(
    ("json", "document", "stdout"),
    [(False, "{}\n", "text\n"), (True, "{}\n", "{}\n"), (True, None, "text\n")],
)
def test_text_or_document_is_printed_and_notices_go_to_stderr(capsys, json, document, stdout):
    outcome = Outcome("text\n", document, ["notice"])
    assert deliver(Request(run=lambda request: outcome, json=json)) == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == (stdout, "notice\n")


@pytest.mark.parametrize("pieces", [0, 2])
@pytest.mark.parametrize(
    ("interrupt", "message", "code"),
    [(KeyboardInterrupt, "interrupted", 130), (Terminated, "terminated", 143)],
)
def test_an_interrupt_tells_how_many_pieces_are_kept(
    capsys, tmp_path, interrupt, message, code, pieces, stand_in
):
    def interrupted(checkpoint):
        for n in range(pieces):
            checkpoint.keep(f"piece {n}", n)
        raise interrupt

    stand_in(interrupted)
    out = tmp_path / "deep" / "out"
    path = out / "bandwidth.checkpoint.jsonl"
    assert main(["study", "bandwidth", "--out", str(out)]) == code
    fate = (
        f"{pieces} finished pieces are kept in {path}; the same command goes on from them"
        if pieces
        else "nothing was written"
    )
    assert capsys.readouterr().err.splitlines() == [f"kneexo: {message}; {fate}"]
    assert list((tmp_path / "deep").rglob("*.*")) == ([path] if pieces else [])
    assert (tmp_path / "deep").exists() == bool(pieces)


def test_finished_pieces_go_only_when_asked(capsys, tmp_path, stand_in):
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    command = ["study", "bandwidth", "--out", str(tmp_path)]

    def interrupted(checkpoint):
        checkpoint.keep("a", 1)
        raise KeyboardInterrupt

    stand_in(interrupted)
    assert main(command) == 130
    pieces_at_start = []
    stand_in(lambda checkpoint: pieces_at_start.append(len(checkpoint)))
    for _ in range(2):
        assert main(command) == 0
        message = (
            f"kneexo: 1 finished pieces of other settings stay in {path}; --restart deletes them"
        )
        assert capsys.readouterr().err.splitlines()[-1] == message
    assert main([*command, "--restart"]) == 0
    assert not path.exists()
    assert pieces_at_start == [1, 1, 0]


def test_a_second_process_is_refused(capsys, tmp_path, stand_in):
    stand_in(lambda checkpoint: pytest.fail("the study began"))
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert main(["study", "bandwidth", "--out", str(tmp_path), "--restart"]) == 2
    assert capsys.readouterr().err == (
        f"kneexo: checkpoint {path}: another process is at work on it; wait until it has ended, or "
        f"choose another directory\n"
    )


def test_damaged_lines_are_one_line_on_stderr(capsys, tmp_path, monkeypatch, stand_in):
    def fail(checkpoint):
        raise WorkerError("no worker")

    def show(message, category, filename, lineno, file=None, line=None):
        sys.stderr.write(warnings.formatwarning(message, category, filename, lineno, line))

    stand_in(fail)
    monkeypatch.setattr(warnings, "showwarning", show)  # as Python does; pytest collects them
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    path.write_text("damaged\ndamaged\n")
    assert main(["study", "bandwidth", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.splitlines() == [
        f"kneexo: checkpoint {path}: 2 damaged lines are skipped",
        "kneexo: no worker",
    ]


def test_an_interrupt_after_the_files_are_written_says_so(capsys, tmp_path, monkeypatch, stand_in):
    stand_in(lambda checkpoint: None)

    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr("kneexo.sweeps.checkpoint.Checkpoint.remove", interrupted)
    assert main(["study", "bandwidth", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == f"kneexo: interrupted; the results are in {tmp_path}\n"
