"""Pieces of an HTML page that stands alone: text is escaped, pictures and videos are inside, nothing is loaded."""

import base64
import html
import pathlib
from collections.abc import Iterable, Mapping
from typing import NamedTuple

_STYLE = """
:root { color-scheme: light; --ink: #1d2733; --soft: #5b6672; --line: #e3e7eb; --accent: #0072B2; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #f6f8fa; font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
header, main, nav { max-width: 980px; margin: 0 auto; padding: 0 18px; }
header { padding-top: 34px; }
h1 { font-size: 1.8rem; margin: 0 0 .2rem; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin: 0 0 .8rem; }
h3 { font-size: 1.02rem; margin: 1.4rem 0 .4rem; }
p { margin: .4rem 0 .8rem; overflow-wrap: anywhere; }
.soft { color: var(--soft); }
nav ul { list-style: none; display: flex; flex-wrap: wrap; gap: .3rem 1.1rem; padding: 0; margin: 14px 0; }
nav a { color: var(--accent); text-decoration: none; }
nav a:hover { text-decoration: underline; }
section { background: #fff; border: 1px solid var(--line); border-radius: 10px; padding: 20px; margin: 0 0 18px; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(165px, 1fr)); gap: 12px; margin-bottom: 6px; }
.card { border: 1px solid var(--line); border-radius: 8px; padding: 12px 14px; background: #fbfcfd; }
.card b { display: block; font-size: 1.45rem; font-weight: 650; color: var(--accent); overflow-wrap: anywhere; }
.card span { color: var(--soft); font-size: .86rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; margin: .2rem 0 .8rem; }
th, td { text-align: left; padding: 5px 12px 5px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 600; color: var(--soft); }
td { font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
figure { margin: 14px 0; }
img, video { max-width: 100%; height: auto; display: block; border-radius: 6px; border: 1px solid var(--line); background: #fff; }
figcaption { color: var(--soft); font-size: .88rem; margin-top: 6px; }
pre { background: #f6f8fa; border: 1px solid var(--line); border-radius: 6px; padding: 12px; overflow-x: auto; font-size: .82rem; line-height: 1.45; }
details > summary { cursor: pointer; color: var(--accent); margin: .4rem 0; }
.outdated { max-width: 980px; margin: 18px auto 0; padding: 12px 18px; background: #fdecea; border: 1px solid #CC3311; border-radius: 8px; }
footer { max-width: 980px; margin: 0 auto; padding: 4px 18px 40px; color: var(--soft); font-size: .85rem; }
"""  # noqa: E501
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
        f"{head}<title>{text(title)}</title><style>{_STYLE}</style></head><body>"
        f"<header><h1>{text(title)}</h1>{paragraph(subtitle, soft=True)}</header>"
        f'<nav aria-label="Contents"><ul>{contents}</ul></nav><main>{bodies}</main>'
        "<footer>Written by agile_jax. Lengths in metres, angles in radians, times in seconds.</footer>"
        "</body></html>\n"
    )
