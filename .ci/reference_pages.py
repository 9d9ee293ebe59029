"""Pages of the site that are made, not written: the front page, every public name, every command."""

import contextlib
import io
import re
from pathlib import Path

import mkdocs_gen_files

import semloc_jax as sj
from semloc_jax.cli.main import VERBS, main

ROOT = Path(__file__).resolve().parents[1]

with mkdocs_gen_files.open("index.md", "w") as page:
    readme = (ROOT / "README.md").read_text(encoding="utf-8").replace("](notebooks/", "](")
    # What is no page of the site is a file of the repository.
    page.write(re.sub(r"\[([^\]]+)\]\((?!http|pictures|\d\d_|OWN_DATA|FIGURES|figures)[^)]+\)", r"\1", readme))

with mkdocs_gen_files.open("reference.md", "w") as page:
    page.write("# Reference\n\nThe public names, in the order of the data flow: `import semloc_jax as sj`.\n")
    for home, names in sj._ROOMS.items():
        page.write(f"\n## {home}\n\n")
        # The reference is made from sources, and the doors of some rooms load names on first use: the module itself.
        homes = {name: getattr(sj, name).__module__ for name in names}
        page.writelines(f"::: {homes[name]}.{name}\n    options:\n      heading_level: 3\n\n" for name in names)

with mkdocs_gen_files.open("commands.md", "w") as page:
    page.write("# Commands\n\nWhat `semloc VERB --help` prints.\n")
    for verb in VERBS:
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
            main([verb, "--help"])
        page.write(f"\n## {verb}\n\n```text\n{said.getvalue().strip()}\n```\n")
