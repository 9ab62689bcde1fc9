"""Blocks of a page as Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from experiments.reporting.blocks import Block, Bullets, Code, Details, Download, Plots, Strip, Table, Text


def markdown(block: Block, stem: str) -> Iterator[str]:
    """Paragraphs of Markdown that show a block; camera pictures are in the page for the browser alone.

    Args:
        block: of the page.
        stem: name of the page's files, which figures and tables are linked by.
    """
    if isinstance(block, Text):
        yield from map(escaped, block.paragraphs)
    elif isinstance(block, Bullets):
        yield "\n".join(f"- {escaped(item)}" for item in block.items)
    elif isinstance(block, Plots):
        for plot in block.plots:
            yield f"![{escaped(plot.caption)}](figures/{stem}-{plot.key}.svg)"
        yield f"*{escaped(block.caption or block.plots[0].caption)}*"
    elif isinstance(block, Table):
        if block.caption and not block.inline:
            yield f"{escaped(block.caption)}: {table_link(block, stem)}."
        elif block.caption:
            yield f"**{escaped(block.caption)}**" + (f" ({table_link(block, stem)})" if block.key is not None else "")
        if block.inline:
            yield markdown_table([block.names, *([cell.marked for cell in row] for row in block.rows)])
    elif isinstance(block, Strip):
        yield f"{escaped(block.label)}: see `report.html`."
    elif isinstance(block, Download) and block.key is not None:
        yield f"{escaped(block.label)}: {table_link(block, stem)}."
    elif isinstance(block, Code):
        yield f"```\n{block.text}\n```"
    elif isinstance(block, Details):
        if not any(isinstance(inner, Table) and inner.caption for inner in block.blocks[:1]):
            yield f"**{escaped(block.summary)}**"  # a table says itself what it is
        for inner in block.blocks:
            yield from markdown(inner, stem)


def table_file(table: Table | Download, stem: str) -> str:
    """Path of a table's file within the page's folder."""
    return f"data/{stem}-{table.key}.csv" if table.key else f"data/{stem}.csv"


def table_link(table: Table | Download, stem: str) -> str:
    """Link to a table's file; empty where it has none."""
    path = table_file(table, stem)
    return "" if table.key is None else f"[`{path}`]({path})"


def markdown_table(rows: Sequence[Sequence[object]]) -> str:
    """Heading and rows as a table of Markdown."""
    head, *lines = [[escaped(str(cell)).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *lines))


def escaped(text: str) -> str:
    """Text in which no name or title can open an HTML tag."""
    return text.replace("<", "&lt;")
