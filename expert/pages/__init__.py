"""Self-contained pages with sortable tables: what those of a run, a batch and an evaluation share."""

from __future__ import annotations

import base64
import hashlib
import re
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Template
    from markupsafe import Markup


@dataclass(frozen=True)
class _Page:
    """A compiled template with its style, its script and the hash of that."""

    template: Template
    style: str
    script: str
    script_hash: str


@cache
def _page(package: str, template: str) -> _Page:
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, TemplateNotFound

    shared, own = PackageLoader("expert.pages", ""), PackageLoader(package, "")
    environment = Environment(
        loader=ChoiceLoader([own, shared]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters["breakable"] = _breakable
    stem = template.partition(".")[0]

    def text(kind: str) -> str:
        parts = [shared.get_source(environment, f"table.{kind}")[0]]
        with suppress(TemplateNotFound):
            parts.append(own.get_source(environment, f"{stem}.{kind}")[0])
        return "".join(parts)

    script = text("js")
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    return _Page(environment.get_template(template), text("css"), script, f"sha256-{digest}")


def _breakable(text: str) -> Markup:
    """Escape a name and let lines break behind its dots and underscores, instead of anywhere."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"([._])", r"\1<wbr>", str(escape(text))))


def render(package: str, template: str, **values: object) -> str:
    """Render a page that needs no other file and no network, and allows no script but its own.

    Parameters
    ----------
    package : str
        Where the template lies, e.g. `expert.batch`; `<stem>.css` and `<stem>.js`, where there are any, lie beside it
        and follow the shared style and script.
    template : str
        `<stem>.html.j2`; it gets `style`, `script` and `script_hash` beside `values`. Values appear as text, never as
        markup.
    """
    from markupsafe import Markup

    page = _page(package, template)
    return page.template.render(
        style=Markup(page.style), script=Markup(page.script), script_hash=page.script_hash, **values
    )
