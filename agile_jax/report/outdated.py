"""Which results a report tells of, and the mark on a report that is older than these.

The page names the sha256 of each summary that it was made from. Whoever makes a new one calls `mark_outdated`, which
needs no more than the page and the summaries. This module loads no heavy library.
"""

import html
import json
import pathlib
import re

from agile_jax.files import sha256, write_atomic

_META = re.compile(r'<meta name="agile-tells-of" content="([^"]*)">')
_BANNER = re.compile(r'<p class="outdated">.*?</p>')
_PLACE = "<body>"


def summaries(run_dir: pathlib.Path) -> dict[str, str]:
    """The sha256 of each summary that a report of the run would tell of, by the path in the run directory."""
    paths = [run_dir / "dataset/summary.json", run_dir / "training/summary.json"]
    paths += sorted(run_dir.glob("evaluation/*.json"))
    return {path.relative_to(run_dir).as_posix(): sha256(path.read_bytes()) for path in paths if path.is_file()}


def meta(told: dict[str, str]) -> str:
    """The entry of the page's head that names the summaries which it tells of."""
    return f'<meta name="agile-tells-of" content="{html.escape(json.dumps(told, sort_keys=True), quote=True)}">'


def mark_outdated(run_dir: pathlib.Path) -> list[str]:
    """Put a banner on a report that is older than what it tells of, or take it off where it is no longer true.

    Returns:
        The summaries that are newer than the report, as paths in the run directory; none without a report.

    Raises:
        OSError: the report cannot be written.
    """
    path = run_dir / "report.html"
    if not path.is_file():
        return []
    page = path.read_bytes().decode("utf-8", "surrogateescape")  # whatever somebody made of it
    now = summaries(run_dir)
    told = _told(page)
    changed = sorted(name for name in {*told, *now} if told.get(name) != now.get(name))
    words = (
        f"This report is out of date: since it was written, {', '.join(changed)} changed. "
        "`agile report RUN_DIR` writes it anew."
    )
    banner = f'<p class="outdated">{html.escape(words)}</p>' if changed else ""
    marked = _BANNER.sub("", page, count=1).replace(_PLACE, _PLACE + banner, 1)
    if marked != page:
        write_atomic(path, marked.encode("utf-8", "surrogateescape"))
    return changed


def _told(page: str) -> dict[str, str]:
    """The summaries that a page names; none where it is damaged or of a version that names none."""
    found = _META.search(page)
    try:
        told = json.loads(html.unescape(found.group(1))) if found else {}
    except ValueError:
        return {}
    return told if isinstance(told, dict) else {}
