"""Accuracy of `nte check` on vectors, turned guides and late channels of rendered clips: how often it is right.

python -m benchmarks.check [--turned | --late] CLIP_OR_FOLDER…

Every clip is checked as it is, and with its vectors in other conventions. A clip is used if it is found plausible as it
is, because it then has enough motion and texture. The table counts, over the used clips, how many wrong conventions are
named rightly, fail with another reason, or pass. A change that only turns a component that is nearly 0 is not another
convention, and is left out (median change of the moving vectors below 2 px).

With --turned, guides are turned over instead: the table counts how many are named rightly, and wrongly, with the
reference and with colour alone. With --late, the channels of the frame before and of the next frame are given instead.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import make_parser, run
from nte.checking import CheckReport, check
from nte.checking.flips import FLIPS, PICTURES, FlipTally
from nte.checking.late import SHOWN, LateTally
from nte.frames.clip import Clip, Pixels
from nte.frames.clip_files import find_clips
from nte.frames.frame import Frame
from nte.frames.sample import FRAMES, PAIRS, spread

Change = Callable[[Pixels, Frame], Pixels]


def _scale(x: float, y: float) -> Pixels:
    return np.array([x, y], np.float32).reshape(1, 2, 1, 1)


def times(x: float, y: float) -> Change:
    return lambda motion, frame: motion * _scale(x, y)


def per_size(x: float, y: float) -> Change:
    return lambda motion, frame: motion * _scale(x / frame.size[1], y / frame.size[0])


# name → (the change of the vectors, words of which the reason must contain one)
WRONG: dict[str, tuple[Change, tuple[str, ...]]] = {
    "sign of x": (times(-1, 1), ("sign",)),
    "sign of y": (times(1, -1), ("sign",)),
    "both signs": (times(-1, -1), ("sign", "direction")),
    "axes swapped": (lambda motion, frame: motion[:, ::-1], ("axis order",)),
    "uv": (per_size(1, 1), ("unit (uv",)),
    "NDC, y up": (per_size(2, -2), ("unit (NDC",)),
    "forward": (lambda motion, frame: frame["forward_motion"], ("direction", "sign")),
    "1/64": (times(1 / 64, 1 / 64), ("do not", "too short", "unit")),
    "half": (times(0.5, 0.5), ("too short",)),
    "zero": (times(0, 0), ("do not",)),
    "random": (lambda m, f: np.random.default_rng(f.index).normal(0, 8, m.shape).astype("f"), ("does not explain",)),
}


class Changed(Clip):
    """A clip with other vectors than it has on disk."""

    def __init__(self, folder: Path, change: Change) -> None:
        super().__init__(folder)
        self.change = change

    def frame(self, *arguments: Any, **options: Any) -> Frame:
        found = super().frame(*arguments, **options)
        return found.with_channels(motion=np.ascontiguousarray(self.change(found["motion"], found)))


def differs(clip: Clip, change: Change) -> bool:
    """Say whether the change matters: by 2 px for the median of the vectors that move by more than 1 px."""
    for frame in clip:
        motion = frame["motion"]
        moving = (np.square(motion).sum(1) > 1) & (frame["depth"] > 0).any(1)
        if moving.sum() > 100:
            apart = np.sqrt(np.square(change(motion, frame) - motion).sum(1))[moving]
            if np.median(apart) > 2:
                return True
    return False


def judge(report: CheckReport, words: tuple[str, ...]) -> str:
    if report.verdict != "implausible":
        return report.verdict
    return "named" if any(word in report.reason for word in words) else "failed"


def turned(folders: Iterable[Path]) -> None:
    """Print how many guides are said to be turned over, of those that are right and of those that are turned."""
    counts: Counter[tuple[str, str, str]] = Counter()
    for folder, light in product(folders, ("reference", "color")):
        clip = Clip(folder)
        names = [name for name in (light, "color", *PICTURES) if name in clip.channels]
        frames = [clip.frame(i, names).torch() for i in sorted(spread(FRAMES, 0, len(clip)))]
        if light not in clip.channels:
            continue
        for how, sides in {"": (), **FLIPS}.items():
            tally = FlipTally()
            for frame in frames:
                tally.add(frame.with_channels(**{name: frame[name].flip(sides) for name in PICTURES if name in frame}))
            told = {finding.channel: finding.found.endswith(how) and how != "" for finding in tally.judge()}
            for name in (name for name in PICTURES if name in clip.channels):
                counts[light, name, "turned" if how else "right"] += 1
                if name in told:
                    counts[light, name, "named" if told[name] else "false"] += 1
    print(f"{'compared with':16}{'guide':18}{'turned':>8}{'named':>8}{'right':>8}{'false':>8}")
    for light, name in product(("reference", "color"), PICTURES):
        row = "".join(f"{counts[light, name, key]:8}" for key in ("turned", "named", "right", "false"))
        print(f"{light:16}{name:18}{row}")


def late(folders: Iterable[Path]) -> None:
    """Print how many channels are said to show another frame, of those that are right and of neighbouring frames."""
    counts: Counter[tuple[str, str, str]] = Counter()
    for folder in folders:
        clip = Clip(folder)
        names = [name for name in ("color", "reference", *SHOWN) if name in clip.channels]
        frames = [clip.frame(i, names).torch() for i in range(min(PAIRS + 3, len(clip)))]
        for name, step in product(("reference", *SHOWN) if "reference" in names else (), (0, -1, 1)):
            if name in names:
                light, tally = "color" if name == "reference" else "reference", LateTally()
                kept = {"color", "reference", name}
                shown = [{n: frames[i + step * (n == name)][n] for n in kept} for i in range(1, len(frames) - 1)]
                for before, now in pairwise(map(Frame, shown)):
                    tally.add(before, now)
                counts[light, name, "late" if step else "right"] += 1
                when = {0: "", -1: "one frame earlier", 1: "one frame later"}[step]
                for finding in tally.judge():
                    right = step and finding.channel == name and finding.found.endswith(when)
                    counts[light, name, "named" if right else "false"] += 1
                    if not right:
                        print(f"false: {folder}: {finding.channel} {finding.found}, given {name} {when}", flush=True)
    print(f"{'compared with':16}{'channel':18}{'late':>8}{'named':>8}{'right':>8}{'false':>8}")
    for other, name in dict.fromkeys(key[:2] for key in counts):
        row = "".join(f"{counts[other, name, key]:8}" for key in ("late", "named", "right", "false"))
        print(f"{other:16}{name:18}{row}")


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = make_parser(__doc__)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--only", nargs="+", help="conventions to try", choices=WRONG)
    parser.add_argument("--turned", action="store_true", help="turn guides over instead of changing vectors")
    parser.add_argument("--late", action="store_true", help="give channels of the frame before, and of the next one")
    options = parser.parse_args(arguments)
    if options.late:
        late(find_clips(options.clips))
        return
    if options.turned:
        turned(find_clips(options.clips))
        return
    right: Counter[str] = Counter()
    table: dict[str, Counter[str]] = {name: Counter() for name in options.only or WRONG}
    for folder in find_clips(options.clips):
        verdict = check(Clip(folder)).verdict
        right[verdict] += 1
        if verdict == "implausible":
            print(f"false alarm: {folder}: {check(Clip(folder)).reason}", flush=True)
        if verdict != "plausible":
            continue
        for name, counts in table.items():
            change, words = WRONG[name]
            if not differs(Clip(folder), change):
                continue
            report = check(Changed(folder, change))
            found = judge(report, words)
            counts[found] += 1
            if found != "named":
                print(f"{found}: {folder}, {name}: {report.reason}", flush=True)
    print(f"as they are: {', '.join(f'{count} {verdict}' for verdict, count in sorted(right.items()))}")
    print(f"{'':14}{'clips':>8}{'named':>8}{'failed':>8}{'undecidable':>13}{'plausible':>11}")
    for name, counts in table.items():
        row = (counts[key] for key in ("named", "failed", "undecidable", "plausible"))
        print(f"{name:14}{counts.total():8}" + "".join(f"{n:{w}}" for n, w in zip(row, (8, 8, 13, 11), strict=True)))


if __name__ == "__main__":
    run(main)
