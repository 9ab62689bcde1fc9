"""A page as one HTML text that loads nothing from elsewhere: `templates/report.html` filled in.

The template escapes every text. Only `svg` fields go in as they are: they come from `figure`, or from code that escapes itself.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from importlib.resources import files

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure as Plot

from experiments.reporting.blocks import Block, Card, Details, Figure, Figures, Plots, Section
from experiments.reporting.figures import svg_element, svg_file


@dataclass(frozen=True)
class Report:
    """A page: what it is about, one-sentence verdict with cards and advice, evidence, assumptions, how to make it again."""

    title: str
    study: str
    headline: str
    passed: bool | None
    cards: tuple[Card, ...]
    advice: tuple[str, ...]
    evidence: tuple[Section, ...]
    assumptions: tuple[Block, ...]
    reproduction: tuple[Block, ...]
    footer: str = ""
    about: tuple[str, ...] = ()
    advice_title: str = "What would help, and what the frames show"


def render(report: Report) -> str:
    """The page as one HTML text that loads nothing from elsewhere; the same for the same report."""
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    source = (files("experiments") / "reporting" / "templates" / "report.html").read_text(encoding="utf-8")
    return environment.from_string(source).render(report=report)


def drawn(block: Block, prefix: str) -> Block:
    """The block with its plots as SVG; `prefix` begins the ids of the page's figures."""
    if isinstance(block, Plots):
        figures = tuple(_embedded(p.svg, f"{prefix}-{p.key}", p.caption) for p in block.plots)
        return Figures(figures, block.caption)
    if isinstance(block, Details):
        return replace(block, blocks=tuple(drawn(inner, prefix) for inner in block.blocks))
    return block


def figure(plot: Plot, key: str, caption: str) -> Figure:
    """A matplotlib figure to stand in a page: scalable, named for screen readers, its ids unlike any other's.

    Args:
        plot: drawn figure.
        key: letters, digits and hyphens, unique in the page.
        caption: what it shows.
    """
    return _embedded(svg_file(plot), key, caption)


def _embedded(svg: str, key: str, caption: str) -> Figure:
    """The text of an SVG file as `figure` makes it."""
    text = svg_element(svg)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{key}-\1"', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{key}-", text)
    text = text.replace("*{", f"#{key} *{{")  # matplotlib's style sheet would else hold for the whole page
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.S)
    head, body = text.split(">", 1)
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)
    label = Markup.escape(caption)
    return Figure(Markup(f'{head} id="{key}" role="img" aria-label="{label}">{body}'), caption)
