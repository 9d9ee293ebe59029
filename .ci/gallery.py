"""Runs the notebooks and shows each by one of its figures: notebooks/pictures/NAME.jpg and notebooks/README.md.

    python .ci/gallery.py [NAME...]    # all of them take about a quarter of an hour of two cores

The figure is the last one of the notebook, or that of the cell with the tag `gallery`. `demo` draws the first picture
of the README: what `semloc demo` finds in its first frame.
"""

import base64
import io
import subprocess
import sys
import tempfile
from pathlib import Path

import nbclient
import nbformat
from PIL import Image

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
DEMO = "demo"
WIDTH_PX = 900
"""As wide as a code host shows a page."""


def main(names: list[str]) -> None:
    """Run the named notebooks (none named: all), then write the page of all that have a picture."""
    paths = sorted(NOTEBOOKS.glob("*.ipynb"))
    unknown = set(names) - {DEMO, *(path.stem for path in paths)}
    if unknown:
        sys.exit(f"unknown: {', '.join(sorted(unknown))}; expected {', '.join([DEMO, *(p.stem for p in paths)])}")
    if not names or DEMO in names:
        _save(_demo(), NOTEBOOKS / "pictures" / f"{DEMO}.jpg", width_px=1520)
    for path in paths:
        if not names or path.stem in names:
            print(f"runs {path.name}", flush=True)
            _save(_figure(_executed(path)), NOTEBOOKS / "pictures" / f"{path.stem}.jpg")
    (NOTEBOOKS / "README.md").write_text(_page(paths), encoding="utf-8")


def _executed(path: Path) -> nbformat.NotebookNode:
    """The notebook with its outputs; it runs in a folder of its own, which is removed again."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = nbclient.NotebookClient(notebook, timeout=900, resources={"metadata": {"path": folder}})
        return client.execute()


def _demo() -> Image.Image:
    """A frame of the demo before and after, see `semloc demo`."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "semloc_jax.cli.main", "demo", "--out", folder], check=True)
        return Image.open(Path(folder) / "overlays" / "000000.png").convert("RGB")


def _figure(notebook: nbformat.NotebookNode) -> Image.Image:
    """The picture that stands for the notebook."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    chosen = [cell for cell in cells if "gallery" in cell.metadata.get("tags", [])] or cells
    pictures = [
        output.data["image/png"] for cell in chosen for output in cell.outputs if "image/png" in output.get("data", {})
    ]
    return Image.open(io.BytesIO(base64.b64decode(pictures[-1]))).convert("RGB")


def _save(picture: Image.Image, path: Path, width_px: int = WIDTH_PX) -> None:
    picture.thumbnail((width_px, width_px))
    picture.save(path, quality=80, optimize=True)


def _page(paths: list[Path]) -> str:
    """Title, first sentences and picture of every notebook."""
    lines = [
        "# Notebooks",
        "",
        "Each explains one topic, needs no data and ends in asserted numbers. Pictures: `python .ci/gallery.py`.",
    ]
    for path in paths:
        first = nbformat.read(path, as_version=4).cells[0].source
        title, _, text = first.partition("\n")
        opening = text.strip().split("\n\n")[0].replace("\n", " ")
        lines += ["", f"## [{title.lstrip('# ')}]({path.name})", "", opening]
        if (NOTEBOOKS / "pictures" / f"{path.stem}.jpg").is_file():
            lines += ["", f"![{title.lstrip('# ')}](pictures/{path.stem}.jpg)"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(sys.argv[1:])
