"""Templates: filters, and names that the data lacks."""

import jinja2
import pytest

from diagramc.c.printer import FLOAT
from diagramc.c.template import _environment, rendered

PACKAGE = rendered.__module__.rpartition(".")[0]


def test_a_name_that_the_data_lacks_is_an_error():
    with pytest.raises(jinja2.UndefinedError, match="first_line"):
        rendered(PACKAGE, "Makefile", name="m")


def test_filters_print_comments_numbers_and_strings_of_c():
    text = "{{ 'a */ b' | comment('  ') }} {{ 0.5 | literal(real) }} {{ 'a\"%b' | quoted }}"
    printed = _environment(PACKAGE).from_string(text).render(real=FLOAT)
    assert printed == '  /* a * / b */ 0.5f "a__b"'
