"""Tables as LaTeX with booktabs."""

from kinebench_drake.suite_report.table import DASH, Column, Table, Value, is_numeric, shown, shown_interval

_SPECIAL = {
    "\\": r"\textbackslash{}",
    **{char: "\\" + char for char in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "[": "{[}",
    "]": "{]}",
    '"': r"\textquotedbl{}",
    DASH: "--",
    "−": "$-$",
}


def latex_text(table: Table) -> str:
    """A `table` environment that needs the package booktabs; intervals stand behind their numbers in small type."""
    align = "".join("r" if is_numeric(table, k) else "l" for k in range(len(table.columns)))
    heads = " & ".join(escape(column.label) for column in table.columns)
    body = []
    for i, row in enumerate(table.rows):
        cells = [
            _cell(value, column, (i, k) in table.bold)
            for k, (column, value) in enumerate(zip(table.columns, row, strict=True))
        ]
        body.append("    " + " & ".join(cells) + r" \\")
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            r"\begin{table}[t]",
            r"  \centering",
            f"  \\caption{{{escape(table.title)}. {escape(table.note)}}}",
            f"  \\label{{tab:{table.name.replace('_', '-')}}}",
            f"  \\begin{{tabular}}{{{align}}}",
            r"    \toprule",
            f"    {heads} \\\\",
            r"    \midrule",
            *body,
            r"    \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def escape(text: str) -> str:
    """Text in which nothing is a LaTeX command."""
    return "".join(_SPECIAL.get(char, char) for char in " ".join(text.split()))


def _cell(value: Value, column: Column, bold: bool) -> str:
    text = escape(shown(value, column))
    interval = shown_interval(value, column)
    text = f"\\textbf{{{text}}}" if bold else text
    return text if interval is None else f"{text} {{\\scriptsize ({escape(interval)})}}"
