"""Examples of docstrings become a section of their own on the pages of the reference."""

import griffe


class DoctestSections(griffe.Extension):
    """Put a heading before the first `>>>` of a docstring."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        """Called for every object that is read."""
        if obj.docstring is None or "\n>>> " not in obj.docstring.value:
            return
        text, example = obj.docstring.value.split("\n>>> ", 1)
        lines = (">>> " + example).splitlines()
        obj.docstring.value = f"{text}\nExamples:\n" + "\n".join(f"    {line}" if line else "" for line in lines)
