"""The mechanism study of the paper's setup; it makes no runs, so nothing is made up."""

from functools import cache

from kneexo.studies.mechanism import mechanism_study


@cache
def made_up():
    return mechanism_study()
