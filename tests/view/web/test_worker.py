"""Requests and answers of the worker; its runs are compared with the compiled engine."""


def test_a_wrong_request_has_an_answer_in_words(worker):
    assert worker.ask(kind="march")["error"] == "kind march is unknown"
    assert worker.ask(kind="run", model="none")["error"] == "model none is not loaded"


def test_loading_has_an_answer(worker):
    assert worker.ask(kind="load", modules={}, models={}) == {"id": worker._count, "points": []}
