"""Damage as disks, networks, editors and strangers do it to files: bits, ends, pieces, numbers and words."""

import random
import re
from collections.abc import Callable

EXTREMES = [bytes([b]) * 4 for b in (0x00, 0xFF)] + [b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\x00\x00\xff\x7f"]
CANARY = "stranger"  # the file that code in damage would make, in the folder that the reader works in
SECRET = "NTE_TEST_SECRET"  # a variable of the environment whose value nothing that is read may hold
RUN = f"touch {CANARY}"
HEAD = 512  # bytes; half of the damage falls into them, as headers are believed
WORDS = (
    "nan", ".inf", "-1", "0", "1e308", "-0.5", "99999999999999999999", "null", "true", "[]", "{}", "''", '"', "[", "}",
    f"!!python/object/apply:os.system ['{RUN}']", f"!!python/object/new:os.system ['{RUN}']",
    f"!!python/object/apply:subprocess.check_call [[touch, {CANARY}]]", "!!python/name:os.system", "!!python/module:os",
    f"${{oc.env:{SECRET}}}", "${oc.env:NONE}", f"${{oc.decode:${{oc.env:{SECRET}}}}}", "../../etc/passwd",
    "/etc/passwd", "ﬁ", "\x00", "\u202e", "x" * 100_000, "[" * 5_000, "&a [*a]", "<<: *x",
)  # fmt: skip


def damage(content: bytes, rng: random.Random, text: bool) -> bytes:
    """Some damage; `text`: also numbers and words in place of others."""
    ways = [_bits, _end, _extreme, _zeros, _repeated, _lost]
    if text:
        ways += [_word, _word, _word, _line, _line]
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = rng.choice(ways)(content, rng)
    return content


def _place(content: bytes, rng: random.Random) -> int:
    return rng.randrange(max(1, min(len(content), HEAD) if rng.random() < 0.5 else len(content)))


def _bits(content: bytes, rng: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.randint(1, 8) if content else 0):
        changed[_place(content, rng)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _end(content: bytes, rng: random.Random) -> bytes:
    return content[: _place(content, rng)]


def _extreme(content: bytes, rng: random.Random) -> bytes:
    at = _place(content, rng)
    return content[:at] + rng.choice(EXTREMES) + content[at + 4 :]


def _zeros(content: bytes, rng: random.Random) -> bytes:
    at, length = _place(content, rng), rng.randint(1, 256)
    return content[:at] + bytes(min(length, len(content) - at)) + content[at + length :]


def _repeated(content: bytes, rng: random.Random) -> bytes:
    at, length = _place(content, rng), rng.randint(1, 256)
    return content[: at + length] + content[at:]


def _lost(content: bytes, rng: random.Random) -> bytes:
    at = _place(content, rng)
    return content[:at] + content[at + rng.randint(1, 64) :]


def _word(content: bytes, rng: random.Random) -> bytes:
    words = list(re.finditer(rb"[\w.+-]+", content))
    if not words:
        return content
    word = rng.choice(words)
    other = rng.choice((rng.choice(WORDS).encode(), rng.choice(words).group()))
    return content[: word.start()] + other + content[word.end() :]


def _line(content: bytes, rng: random.Random) -> bytes:
    lines = content.split(b"\n")
    at = rng.randrange(len(lines))
    ways: list[Callable[[], list[bytes]]] = [
        lambda: lines[:at] + lines[at + 1 :],
        lambda: [*lines[:at], lines[at], *lines[at:]],
        lambda: [*lines[:at], b"  " + lines[at], *lines[at + 1 :]],
    ]
    return b"\n".join(rng.choice(ways)())
