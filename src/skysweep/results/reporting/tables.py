"""A table as Markdown and as LaTeX."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from skysweep.results.reporting.html import Grid

_SYMBOL = re.compile(r"\b([ndchv])_([cCStz])\b")  # the paper's n_c, d_c, h_S, h_C, c_t; v_S, v_C, d_z
_LATEX = {character: f"\\{character}" for character in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "∞": r"$\infty$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "<": r"$<$",
    ">": r"$>$",
    "°": r"$^\circ$",
    "×": r"$\times$",
    "\n": " ",
}


def markdown(grid: Grid, left: int = 0) -> str:
    """A table in Markdown. Of numbers, all columns but the first ``left`` are aligned right."""
    n = len(grid.header)
    marks = ["---"] * n if grid.words else [":---"] * left + ["---:"] * (n - left)
    header, *rows = ([_one_line(text) for text in row] for row in (grid.header, *grid.rows))
    lines = [f"| {' | '.join(row)} |" for row in (header, marks, *rows)]
    return "\n".join([f"**{grid.caption}**", "", *lines]) + "\n"


def _one_line(text: str) -> str:
    """A cell without the line breaks that narrow terminals need."""
    return text.replace("|", r"\|").replace("-\n", "").replace("\n", " ")


def latex(grid: Grid, label: str) -> str:
    """A table in LaTeX with booktabs' rules, as wide as the page, with the best rows in bold."""
    columns = "l" * len(grid.header) if grid.words else "l" + "r" * (len(grid.header) - 1)
    lines = [
        r"\begin{table*}",
        r"  \centering\footnotesize",
        rf"  \caption{{{latex_text(grid.caption)}}}",
        rf"  \label{{{label}}}",
        rf"  \begin{{tabular}}{{@{{}}{columns}@{{}}}}",
        r"    \toprule",
        f"    {' & '.join(map(latex_text, grid.header))} \\\\",
        r"    \midrule",
    ]
    for index, row in enumerate(grid.rows):
        first, *others = map(latex_text, row)
        first = rf"\textbf{{{first}}}" if index in grid.best else first
        lines.append(f"    {' & '.join([first, *others])} \\\\")
    return "\n".join([*lines, r"    \bottomrule", r"  \end{tabular}", r"\end{table*}"]) + "\n"


def latex_text(text: str) -> str:
    """Plain text for LaTeX, with the paper's symbols and minus signs in math."""
    parts, end = [], 0
    for symbol in _SYMBOL.finditer(text):
        parts += [_escaped(text[end : symbol.start()]), f"${symbol[1]}_{symbol[2]}$"]
        end = symbol.end()
    return "".join([*parts, _escaped(text[end:])])


def _escaped(text: str) -> str:
    escaped = "".join(_LATEX.get(character, character) for character in text)
    return re.sub(r"(?<![\w.])-(?=\d)", "$-$", escaped)


def math_text(text: str) -> str:
    """Plain text for matplotlib, with the paper's symbols in math."""
    return _SYMBOL.sub(r"$\1_\2$", text.replace("$", r"\$"))


def write_tables(stem: Path, grids: Sequence[Grid]) -> None:
    """Write grids below one another as ``stem.md`` and ``stem.tex``."""
    text = "\n".join(markdown(grid, left=1) for grid in grids)
    stem.with_suffix(".md").write_text(text, encoding="utf-8")
    parts = [latex(grid, f"tab:{stem.name}-{index}") for index, grid in enumerate(grids, 1)]
    preamble = "% needs \\usepackage{booktabs}\n\n"
    stem.with_suffix(".tex").write_text(preamble + "\n".join(parts), encoding="utf-8")
