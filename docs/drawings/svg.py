"""Words for drawing: each function returns a piece of SVG. Colours are readable on light and on dark pages."""

from collections.abc import Iterable

INK, FAINT, NOW, PAST, GOOD, BAD = "#78909c", "#90a4ae", "#1e88e5", "#fb8c00", "#43a047", "#e53935"
Point = tuple[float, float]


def drawing(width: int, height: int, parts: Iterable[str]) -> str:
    """Return the file. width, height: of the drawing, in its own units; pages scale it."""
    heads = "".join(
        f'<marker id="{colour[1:]}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto">'
        f'<path d="M0 0L10 5L0 10z" fill="{colour}"/></marker>'
        for colour in (INK, FAINT, NOW, PAST, GOOD, BAD)
    )
    style = "font-family:system-ui,sans-serif;font-size:14px"
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'style="{style}">\n<defs>{heads}</defs>\n{body}\n</svg>\n'
    )


def arrow(start: Point, end: Point, colour: str = INK, dashed: bool = False) -> str:
    """Draw a straight arrow from start to end."""
    return f'{_line(start, end, colour, dashed)} marker-end="url(#{colour[1:]})"/>'


def line(start: Point, end: Point, colour: str = INK, dashed: bool = False) -> str:
    return f"{_line(start, end, colour, dashed)}/>"


def box(corner: Point, size: Point, colour: str = INK, fill: str = "none", opacity: float = 1.0) -> str:
    (x, y), (width, height) = corner, size
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="2" stroke="{colour}" stroke-width="1.5" '
        f'fill="{fill}" fill-opacity="{opacity:g}"/>'
    )


def dot(place: Point, colour: str = INK, radius: float = 4.5) -> str:
    return f'<circle cx="{place[0]:g}" cy="{place[1]:g}" r="{radius:g}" fill="{colour}"/>'


def words(place: Point, text: str, colour: str = INK, anchor: str = "start") -> str:
    """Write a line of text. anchor: which part of it lies at the place, start, middle or end."""
    return f'<text x="{place[0]:g}" y="{place[1]:g}" fill="{colour}" text-anchor="{anchor}">{text}</text>'


def _line(start: Point, end: Point, colour: str, dashed: bool) -> str:
    dash = ' stroke-dasharray="5 4"' if dashed else ""
    (a, b), (c, d) = start, end
    return f'<line x1="{a:g}" y1="{b:g}" x2="{c:g}" y2="{d:g}" stroke="{colour}" stroke-width="2"{dash}'
