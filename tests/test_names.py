"""Each public class has one meaning: no two rooms use one name for different things."""

import ast
from collections import defaultdict

from tests.test_architecture import _files, _module_name


def test_no_two_classes_have_one_name():
    homes = defaultdict(list)
    for path in _files():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            is_command = _module_name(path).startswith("semloc_jax.cli.")  # the Options of each verb
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_") and not is_command:
                homes[node.name].append(_module_name(path))
    twice = {name: where for name, where in homes.items() if len(where) > 1}
    assert not twice, f"one name for different things: {twice}; name each for what it is"
