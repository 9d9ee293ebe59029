"""The one exception for bad input: whatever a file has put into its text, it is one line of plain text."""

import pytest

from semloc_jax.errors import SemlocError


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("not valid\n  in line 2", "not valid in line 2"),
        ("a\r\nb", "a b"),
        ("name \x1b[2J\x07", "name ?[2J?"),
        ("tab\tstays, é too", "tab\tstays, é too"),
        ("", ""),
    ],
)
def test_a_message_is_one_line_of_plain_text(given, told):
    assert str(SemlocError(given)) == told
