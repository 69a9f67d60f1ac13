"""The drawings: two frames side by side, the previous one on the left, the current one on the right."""

from collections.abc import Callable

from svg import BAD, FAINT, GOOD, INK, NOW, PAST, Point, arrow, box, dot, drawing, line, words

LEFT, RIGHT, TOP, WIDE, HIGH = 20, 340, 40, 280, 170


def frames() -> list[str]:
    """The borders of both frames, with their names."""
    return [
        box((LEFT, TOP), (WIDE, HIGH), FAINT),
        box((RIGHT, TOP), (WIDE, HIGH), FAINT),
        words((LEFT, TOP - 12), "frame i−1"),
        words((RIGHT, TOP - 12), "frame i"),
    ]


def thing(x: float, frame: int, colour: str = INK) -> str:
    """A box that stands in front of a wall; x is its left side in the frame."""
    return box((frame + x, TOP + 60), (80, 80), colour, colour, 0.25)


def motion() -> str:
    """The traditional vector: from a pixel to the same surface point in the previous frame."""
    before: Point = (LEFT + 70, TOP + 100)
    now: Point = (RIGHT + 150, TOP + 100)
    ghost: Point = (RIGHT + 70, TOP + 100)
    return drawing(
        640, 225,
        [
            *frames(), thing(30, LEFT), thing(110, RIGHT), box((RIGHT + 30, TOP + 60), (80, 80), FAINT),
            dot(before, PAST), dot(now, NOW), arrow(now, ghost, NOW), dot(ghost, PAST),
            words((now[0] + 8, now[1] - 8), "x", NOW), words((ghost[0] - 50, ghost[1] - 70), "y = x + motion(x)", PAST),
            words((before[0] + 8, before[1] - 8), "y", PAST),
        ],
    )  # fmt: skip


def disocclusion() -> str:
    """The wall that the box uncovers has no past in the image, and what the traditional vector finds there."""
    shown: Point = (RIGHT + 70, TOP + 100)
    return drawing(
        640, 225,
        [
            *frames(), thing(30, LEFT), thing(140, RIGHT),
            box((RIGHT + 30, TOP + 60), (80, 80), BAD, BAD, 0.2),
            dot(shown, NOW), words((shown[0] + 8, shown[1] - 8), "x", NOW),
            dot((LEFT + 70, TOP + 100), BAD), words((LEFT + 115, TOP + 155), "the box, not the wall", BAD),
            words((RIGHT + 34, TOP + 155), "disoccluded", BAD),
        ],
    )  # fmt: skip


def dual() -> str:
    """The dual vector: back along the motion of what hid the pixel."""
    x: Point = (RIGHT + 120, TOP + 100)
    z: Point = (RIGHT + 210, TOP + 100)
    return drawing(
        640, 225,
        [
            *frames(), thing(80, LEFT), thing(170, RIGHT), box((RIGHT + 80, TOP + 60), (80, 80), FAINT),
            dot((LEFT + 120, TOP + 100), PAST), arrow((LEFT + 120, TOP + 100), (LEFT + 210, TOP + 100), PAST),
            words((LEFT + 124, TOP + 88), "y", PAST), words((LEFT + 168, TOP + 88), "f(y)", PAST),
            dot((LEFT + 30, TOP + 100), GOOD), words((LEFT + 12, TOP + 84), "x − f(y)", GOOD),
            dot(x, NOW), words((x[0] + 6, x[1] - 10), "x", NOW),
            arrow(x, (RIGHT + 30, TOP + 100), GOOD), words((RIGHT + 42, TOP + 126), "dual", GOOD),
            dot(z, PAST), words((z[0] + 6, z[1] - 10), "z", PAST),
        ],
    )  # fmt: skip


def demodulation() -> str:
    """Light divided by texture is smooth, so a filter may be wide."""
    parts, stripes = [], (0, 1, 0, 1, 1, 0, 1, 0)
    for column, (title, kind) in enumerate((("colour", "both"), ("albedo", "texture"), ("irradiance", "light"))):
        at = 20 + 215 * column
        parts.append(words((at + 80, 28), title, INK, "middle"))
        for i, dark in enumerate(stripes):
            texture = 0.35 if dark else 0.9
            light = 0.25 + 0.09 * i
            value = round(255 * {"both": texture * light, "texture": texture, "light": light}[kind] ** 0.45)
            grey = f"#{value:02x}{value:02x}{value:02x}"
            parts.append(box((at + 20 * i, 40), (20, 90), grey, grey))
    parts += [words((190 + 215 * i, 92), sign) for i, sign in enumerate("÷=")]
    parts += [
        arrow((530, 140), (530, 165), NOW), words((530, 183), "filter", NOW, "middle"),
        arrow((505, 178), (340, 178), NOW), words((325, 183), "× albedo", NOW, "end"),
    ]  # fmt: skip
    return drawing(640, 195, parts)


def kernels() -> str:
    """A network does not paint pixels: it gives each pixel the weights of those around it."""
    weights = ((1, 2, 3, 1, 0), (2, 5, 7, 2, 0), (3, 7, 9, 3, 0), (2, 5, 7, 2, 0), (1, 2, 3, 1, 0))
    parts = [words((90, 28), "noisy pixels", INK, "middle"), words((300, 28), "predicted weights", INK, "middle")]
    noise = (3, 9, 1, 6, 4, 8, 2, 7, 0, 5)
    for row in range(5):
        for column in range(5):
            value = round(255 * ((noise[(3 * row + 7 * column) % 10] + 3) / 14 if column < 4 else 0.12))
            grey = f"#{value:02x}{value:02x}{value:02x}"
            parts.append(box((30 + 24 * column, 40 + 24 * row), (24, 24), grey, grey))
            weight = weights[row][column] / 9
            parts.append(box((240 + 24 * column, 40 + 24 * row), (24, 24), FAINT, NOW, weight))
    parts += [
        box((78, 88), (24, 24), NOW), words((195, 106), "×", INK, "middle"),
        line((126, 40), (126, 160), BAD, True), line((336, 40), (336, 160), BAD, True),
        words((400, 106), "Σ =", INK, "middle"), box((440, 88), (24, 24), "#8c8c8c", "#8c8c8c"),
        words((452, 78), "one pixel", INK, "middle"),
    ]  # fmt: skip
    return drawing(500, 175, parts)


DRAWINGS: dict[str, Callable[[], str]] = {
    "motion": motion, "disocclusion": disocclusion, "dual": dual, "demodulation": demodulation, "kernels": kernels,
}  # fmt: skip
