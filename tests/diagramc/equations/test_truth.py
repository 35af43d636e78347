"""Branches on Drake's scalars: a number decides, or an error."""

from contextlib import suppress
from threading import Thread

import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable

from diagramc import truth_of_scalars

X = Expression(Variable("x"))


@pytest.mark.parametrize(
    "branch",
    [
        lambda: 1 if X else 2,
        lambda: X and 1,
        lambda: X or 1,
        lambda: not X,
        lambda: any([X]),
        lambda: [n for n in (1,) if X],
        lambda: {0.0: 1}.get(X, 2),
        lambda: X in {1.0},
        lambda: 1 if X > 0.0 else 2,
        lambda: str(X) == "1.0",
        lambda: f"{X}",
        lambda: (X > 0.0) == True,  # noqa: E712
        lambda: (X > 0.0) != True,  # noqa: E712
        lambda: (X > 0.0) in (False, 1),
        lambda: (X > 0.0) == (X > 1.0),
    ],
)
def test_a_branch_on_an_expression_raises(branch) -> None:
    with pytest.raises(TypeError, match="of a symbolic value"), truth_of_scalars():
        branch()


def test_the_error_is_raised_after_a_body_that_swallows_it() -> None:
    def swallows() -> None:
        with truth_of_scalars(), suppress(TypeError):
            assert X

    with pytest.raises(TypeError, match="`__bool__` of a symbolic value"):
        swallows()


def test_a_constant_expression_follows_its_number() -> None:
    zero, two = Expression(0.0), Expression(2.0)
    with truth_of_scalars():
        assert not zero
        assert two
        assert two > 1.0
        assert not two < 1.0
        assert {2.0: "found"}.get(two) == "found"
        assert str(two) == "2.0"
        assert (two > 1.0) == True  # noqa: E712
        assert (two > 1.0) != (two > 3.0)


def test_a_branch_on_an_autodiff_scalar_follows_its_value() -> None:
    zero, one = AutoDiffXd(0.0, [1.0]), AutoDiffXd(1.0, [1.0])
    assert zero, "pydrake's own truth value; without this fault the module is not needed"
    with truth_of_scalars():
        assert not zero
        assert one
        with truth_of_scalars():
            assert not zero
        assert not zero
    assert zero


def test_the_classes_are_restored_after_an_error() -> None:
    before = [vars(kind).get("__bool__") for kind in (Expression, AutoDiffXd)]
    with pytest.raises(ValueError, match="body"), truth_of_scalars():
        raise ValueError("body")
    assert [vars(kind).get("__bool__") for kind in (Expression, AutoDiffXd)] == before
    assert X


def test_other_threads_keep_the_truth_value_of_python() -> None:
    seen = []
    with truth_of_scalars():
        thread = Thread(target=lambda: seen.append(bool(X)))
        thread.start()
        thread.join()
    assert seen == [True]
