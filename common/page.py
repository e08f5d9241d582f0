"""What every report is made of: figures written twice and set into one page that needs nothing but itself."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure

from twinbench.common.store import write_atomically
from twinbench.common.style import FAINT, INK, MUTED, PAPER, png, settle, svg

THEMED = {INK: "var(--ink)", MUTED: "var(--muted)", FAINT: "var(--rule)", PAPER: "var(--paper)"}
"""Colours of the figures that follow the reader's light or dark setting; the data's own do not."""


PX_PER_PT = 4 / 3


class Drawing(NamedTuple):
    """A figure with its caption and its title in words.

    Where there is no figure, ``missing`` says why, and is empty if none belongs there.
    """

    name: str
    caption: str
    figure: Figure | None
    missing: str
    title: str = ""


def render(template: Path, **values: Any) -> str:
    """A page from a template; a value that it asks for and does not get is an error."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([template.parent, Path(__file__).parent / "templates"]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(template.name).render(**values)


def write_figures(
    folder: Path, drawings: Iterable[Drawing], earlier: Mapping[str, str] = MappingProxyType({})
) -> list[dict[str, Any]]:
    """Write each figure as PNG and SVG, and return what a page shows of it: name, title, caption, svg, missing.

    Files of a figure that could not be drawn this time are removed.

    Args:
        earlier: by name, figures of which an earlier drawing is kept, and why.
    """
    shown: list[dict[str, Any]] = []
    for name, caption, figure, missing, title in drawings:
        about = {"name": name, "title": title or name.replace("_", " ").capitalize(), "caption": caption}
        if name in earlier:
            kept = kept_figure(folder, about, earlier[name])
            if kept["svg"] or figure is not None or missing:
                shown.append(kept)
            continue
        files = {suffix: folder / f"{name}.{suffix}" for suffix in ("png", "svg")}
        if figure is None:
            for path in files.values():
                path.unlink(missing_ok=True)
            if missing:
                shown.append({**about, "svg": None, "missing": missing})
            continue
        settle(figure)
        drawn = svg(figure)
        write_bytes(files["png"], png(figure))
        write_bytes(files["svg"], drawn.encode())
        shown.append({**about, "svg": Markup(inline_svg(drawn, name)), "missing": ""})
    return shown


def kept_figure(folder: Path, about: dict[str, Any], why: str) -> dict[str, Any]:
    """An earlier drawing as a page shows it; ``about`` holds its name, title and caption."""
    name = about["name"]
    vector, raster = (folder / f"{name}.{suffix}" for suffix in ("svg", "png"))
    if vector.is_file():
        svg = Markup(inline_svg(vector.read_text(encoding="utf-8"), name))
    elif raster.is_file():
        picture = base64.b64encode(raster.read_bytes()).decode()
        svg = Markup('<img alt="{}" src="data:image/png;base64,{}">').format(name, picture)
    else:
        return {**about, "svg": None, "missing": why}
    caption = f"{about['caption']} Drawn by an earlier run, and nothing newer is in it: {why}."
    return {**about, "caption": caption, "svg": svg, "missing": ""}


def inline_svg(drawn: str, name: str) -> str:
    """An SVG file's text made fit to stand in an HTML page: no prologue, names of its own, themed colours."""
    drawn = drawn[drawn.index("<svg") :]
    drawn = re.sub(r"<metadata>.*?</metadata>", "", drawn, flags=re.DOTALL)
    drawn = re.sub(r'\b(id=")', rf"\g<1>{name}-", drawn)
    drawn = re.sub(r'((?:xlink:href="|url\()#)', rf"\g<1>{name}-", drawn)
    for colour, themed in THEMED.items():
        drawn = drawn.replace(colour, themed)
    # Sized by the page's style, which is told how large its type is right.
    width = re.search(r'\bwidth="([\d.]+)pt"', drawn)
    drawn = re.sub(r'\b(?:width|height)="[\d.]+pt" ?', "", drawn, count=2)
    size = ""
    if width:
        size = f'style="--px: {float(width.group(1)) * PX_PER_PT:.0f}px" '
    return drawn.replace("<svg ", f'<svg {size}role="img" aria-labelledby="{name}-caption" ', 1)


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes atomically."""
    write_atomically(path, lambda beside: beside.write_bytes(content))
