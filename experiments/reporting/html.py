"""A page as one HTML text that loads nothing from elsewhere: `templates/report.html` filled in.

The template escapes every text. Only `svg` fields go in as they are: they come from `embedded`, or from code that escapes itself.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup

from experiments.reporting.blocks import Block, Plot
from experiments.reporting.figures import svg_element


def render(page: Any, assumptions: Sequence[Block], reproduction: Sequence[Block], footer: str) -> str:
    """The page as one HTML text that loads nothing from elsewhere; the same for the same page.

    Args:
        page: an `experiments.reporting.page.Page`.
        assumptions: with their sources, and what is not modelled.
        reproduction: how to make the page again.
        footer: one line about software and run.
    """
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["embedded"] = embedded
    source = (files("experiments") / "reporting" / "templates" / "report.html").read_text(encoding="utf-8")
    template = environment.from_string(source)
    return template.render(page=page, assumptions=assumptions, reproduction=reproduction, footer=footer)


def embedded(plot: Plot, prefix: str) -> Markup:
    """A plot as an element of a page: scalable, named for screen readers, its ids unlike any other's.

    Args:
        plot: its key is unique in the page.
        prefix: letters, digits and hyphens that begin the ids of the page's figures.
    """
    key = f"{prefix}-{plot.key}"
    text = svg_element(plot.svg)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{key}-\1"', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{key}-", text)
    text = text.replace("*{", f"#{key} *{{")  # matplotlib's style sheet would else hold for the whole page
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.S)
    head, body = text.split(">", 1)
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)
    label = Markup.escape(plot.caption)
    return Markup(f'{head} id="{key}" role="img" aria-label="{label}">{body}')
