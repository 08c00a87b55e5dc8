"""Pieces of an HTML page that stands alone: text is escaped, pictures and videos are inside, nothing is loaded."""

import base64
import html
import pathlib
from collections.abc import Iterable, Mapping
from typing import NamedTuple

_STYLE = pathlib.Path(__file__).with_name("page.css")
# Even if a text slipped through unescaped, a browser would run and load nothing.
_POLICY = "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'"


class Section(NamedTuple):
    """A part of the page with an entry in its table of contents."""

    anchor: str  # letters and hyphens
    title: str
    body: str  # HTML


def text(value: object) -> str:
    """The value as escaped text; numbers with four significant digits, lists and objects in one line."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return html.escape(f"{value:.4g}")
    if isinstance(value, Mapping):
        return ", ".join(f"{text(key)}: {text(item)}" for key, item in value.items()) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(text(item) for item in value) or "none"
    return html.escape(str(value), quote=True)


def paragraph(words: str, soft: bool = False) -> str:
    """A paragraph of plain text."""
    kind = "soft" if soft else "plain"
    return f'<p class="{kind}">{text(words)}</p>'


def table(head: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """A table of plain values."""
    titles = "".join(f'<th scope="col">{text(cell)}</th>' for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{text(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table></div>'


def cards(entries: Iterable[tuple[str, str]]) -> str:
    """Large values with a small label below."""
    inner = "".join(
        f'<div class="card"><b>{text(value)}</b><span>{text(label)}</span></div>' for value, label in entries
    )
    return f'<div class="cards">{inner}</div>'


def listing(title: str, content: str) -> str:
    """A text as it is, folded away under its title."""
    return f"<details><summary>{text(title)}</summary><pre>{text(content)}</pre></details>"


def picture(path: pathlib.Path, caption: str) -> str:
    """A PNG with its caption."""
    source = f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"
    return f'<figure><img src="{source}" alt="{text(caption)}"><figcaption>{text(caption)}</figcaption></figure>'


def film(path: pathlib.Path, caption: str) -> str:
    """An mp4 with its caption."""
    source = f"data:video/mp4;base64,{base64.b64encode(path.read_bytes()).decode()}"
    player = f'<video controls muted loop playsinline preload="metadata" src="{source}"></video>'
    return f"<figure>{player}<figcaption>{text(caption)}</figcaption></figure>"


def page(title: str, subtitle: str, sections: Iterable[Section], head: str = "") -> str:
    """The whole document; `head` is more HTML for its head."""
    sections = list(sections)
    contents = "".join(f'<li><a href="#{text(part.anchor)}">{text(part.title)}</a></li>' for part in sections)
    bodies = "".join(
        f'<section id="{text(part.anchor)}"><h2>{text(part.title)}</h2>{part.body}</section>' for part in sections
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{text(_POLICY)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"{head}<title>{text(title)}</title><style>{_STYLE.read_text()}</style></head><body>"
        f"<header><h1>{text(title)}</h1>{paragraph(subtitle, soft=True)}</header>"
        f'<nav aria-label="Contents"><ul>{contents}</ul></nav><main>{bodies}</main>'
        "<footer>Written by agile_jax. Lengths in metres, angles in radians, times in seconds.</footer>"
        "</body></html>\n"
    )
