"""Messages: one line each, whatever they name."""

import pickle

import pytest

from kneexo import errors
from kneexo.errors import KneexoError, escaped, shortened, shown

ERRORS = {e for e in vars(errors).values() if isinstance(e, type) and issubclass(e, KneexoError)}


@pytest.mark.parametrize("error", sorted(ERRORS, key=str))
def test_every_error_is_one_line_here_and_in_another_process(error):
    raised = error("a\nb\x1b λ\u2028")
    for copy in (raised, pickle.loads(pickle.dumps(raised))):
        assert type(copy) is error
        assert str(copy) == "a\\nb\\x1b λ\\u2028"


def test_text_for_a_message():
    assert escaped("λ …") == "λ …"
    assert shortened("x" * 120) == "x" * 120
    assert shortened("a" * 100 + "b" * 100) == "a" * 60 + " … " + "b" * 57
    assert len(shown("\n" * 5000)) == 300
