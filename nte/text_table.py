"""Tables as plain text, for terminals."""


def aligned(columns: list[list[str]]) -> str:
    """Lay columns of text side by side: the first column is aligned to the left, all others to the right."""
    widths = [max(map(len, column)) for column in columns]
    lines = []
    for row in zip(*columns, strict=True):
        first, *rest = (cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        lines.append("  ".join([row[0].ljust(len(first)), *rest]).rstrip())
    return "\n".join(lines)
