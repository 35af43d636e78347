import pytest

from kneexo.errors import ScenarioError


@pytest.fixture
def write(tmp_path):
    """The function ``write(content)``: writes a file and returns its path."""

    def make(content):
        path = tmp_path / "table.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return make


@pytest.fixture
def fault():
    """The function ``fault(function, *arguments)``: the message of the error, without folders."""

    def message_of(function, *arguments):
        with pytest.raises(ScenarioError) as caught:
            function(*arguments)
        message = str(caught.value)
        assert message.isprintable()
        return message.rpartition("/")[2]

    return message_of
