"""The verdict about motion vectors from votes: weak evidence names no convention."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot
from statistics import median
from typing import Literal

from nte.checking.jitter import without_jitter
from nte.checking.votes import RIVALS, STILL_PX, Votes
from nte.motion.conventions import Convention

Verdict = Literal["plausible", "undecidable", "implausible"]

ENOUGH = 6  # least number of votes for a verdict
WITHOUT_WORD = 0.05  # share of votes against the vectors up to which they are ignored; right ones have 0 to 0.01
OFTEN = 1 / 3  # least share of the frames that vote, and two of them, whose vectors are of another kind than the rest
EXPLAINS_BAD, EXPLAINS_GOOD = 0.7, 0.8  # shares of votes against and for that a convention must explain to be named


@dataclass(frozen=True)
class Judgement:
    """A verdict, its reason, and the convention that the vectors follow: nte's, another one, or None if unknown."""

    verdict: Verdict
    reason: str
    convention: Convention | None = None


def judge_votes(pairs: Sequence[Votes], frames: Sequence[int] = ()) -> Judgement:
    """Weigh the votes of a clip's pairs of frames and judge its motion vectors.

    Votes against the vectors count only if they come from at least half of the pairs that vote: one bad frame, or a
    cut, does not condemn the clip. Fewer than six votes, or votes that disagree, are undecidable, and so are votes
    against the vectors that camera jitter explains. If those that count are more than a twentieth of all votes, the
    vectors are never plausible. frames: the numbers of the pairs' second frames; without them pairs count from 1.
    """
    frames = frames or range(1, len(pairs) + 1)
    judgement = _weigh(pairs, frames)
    if judgement.verdict != "implausible" or _weigh(without_jitter(pairs), frames).verdict == "implausible":
        return judgement
    return Judgement("undecidable", f"{_counts(_total(pairs))}, by no more than camera jitter, which vectors leave out")


def contradicts(pair: Votes) -> bool:
    """Tell whether most votes of one pair of frames, and enough of them, are against its vectors."""
    return len(pair.against) >= ENOUGH and pair.weight_against > pair.good


def confirms(pair: Votes) -> bool:
    """Tell whether most votes of one pair of frames, and enough of them, are for its vectors."""
    return pair.good >= ENOUGH and pair.good > pair.weight_against


def _weigh(pairs: Sequence[Votes], frames: Sequence[int]) -> Judgement:
    total = _total(pairs)
    bad = len(total.against)
    voting = [pair for pair in pairs if pair.good or pair.against]
    lasting = 2 * sum(bool(pair.against) for pair in voting) >= len(voting)
    counts = _counts(total)
    counted = bad >= ENOUGH and total.weight_against > WITHOUT_WORD * (total.good + total.weight_against)
    if counted and lasting and (rival := _who_explains(total)) is not None:
        explained = f"it explains {total.bad_by(rival)} of {bad} pieces of the picture that contradict the vectors"
        return Judgement("implausible", f"'motion' has another convention: {rival}: {explained}", rival)
    if counted and (differs := _what_differs(pairs, frames)):
        return Judgement("implausible", f"{differs}: {counts}")
    if counted and lasting:
        if total.weight_against > total.good:
            return Judgement("implausible", f"{_what_moves(total)}: {counts}, and no known convention fits")
        # Such as an object whose own motion the vectors leave out, or short vectors of half their length.
        return Judgement("undecidable", f"in some places {_what_moves(total)}: {counts}")
    if total.good >= ENOUGH and total.good > total.weight_against:
        return Judgement("plausible", counts, Convention())
    return Judgement("undecidable", f"{counts}: {ENOUGH} are needed, and most must agree")


def _what_differs(pairs: Sequence[Votes], frames: Sequence[int]) -> str:
    """Say what the vectors of some frames are if those of the others are right; "" if unknown, or of no frames."""
    bad = [(frame, pair) for frame, pair in zip(frames, pairs, strict=True) if contradicts(pair)]
    good = sum(map(confirms, pairs))
    if len(bad) < max(2, OFTEN * (len(bad) + good)) or not good:
        return ""
    total = _total([pair for _, pair in bad])
    rival = _who_explains(total)
    given = [hypot(*piece.given) for piece in total.against if piece.given]
    if given and max(given) < STILL_PX:
        what = "it is 0 there, and the picture moves"
    elif rival is not None:
        what = f"it has another convention there: {rival}"
    else:
        return ""
    where = f"in {len(bad)} of {len(pairs)} frames that were judged, the first is {bad[0][0]}"
    return f"'motion' is of another kind {where}: {what}"


def _total(pairs: Sequence[Votes]) -> Votes:
    total = Votes()
    for pair in pairs:
        total.add(pair)
    return total


def _counts(total: Votes) -> str:
    bad, estimated = len(total.against), round(total.weight_against)  # of more pieces than a sample, in large images
    more = f" of about {estimated}" if estimated > bad else ""
    return f"{total.good} pieces of the picture confirm the vectors, {bad}{more} contradict them"


def _who_explains(votes: Votes) -> Convention | None:
    """Find the convention that explains most pieces that contradict the vectors and most that confirm them.

    None if there is no such convention. Of several that explain nearly as much, the one that differs least from nte's
    is returned: at constant speed «forward» and «opposite sign» agree, and sideways motion says nothing about y.
    """
    bad = len(votes.against)
    able = [
        rival
        for rival in RIVALS
        if votes.bad_by(rival) >= EXPLAINS_BAD * bad and votes.good_by[rival] >= EXPLAINS_GOOD * votes.good
    ]
    if not able:
        return None
    most = max(votes.bad_by(rival) + votes.good_by[rival] for rival in able)
    close = [rival for rival in able if votes.bad_by(rival) + votes.good_by[rival] >= 0.95 * most]
    return min(close, key=_strangeness)


def _strangeness(convention: Convention) -> tuple[int, int]:
    both_signs = convention.signs == (-1, -1)
    differs = (convention.signs != (1, 1)) + convention.swapped + (convention.unit != "pixels") + convention.forward
    return differs, 0 if both_signs else 1 if not convention.forward else 2


def _what_moves(votes: Votes) -> str:
    """Describe in words how the vectors differ from the true motion of the picture."""
    known = [(piece.given, piece.seen) for piece in votes.against if piece.given and piece.seen]
    if not known:
        return "'motion' does not lead to where objects were"
    given, seen = (median(hypot(*pair[i]) for pair in known) for i in (0, 1))
    if given < STILL_PX:
        lengths = f"it moves by about {seen:.3g} px, they are {given:.2g} px long"
        return f"the picture changes and the vectors do not: {lengths}"
    along = [(g[0] * s[0] + g[1] * s[1]) / (hypot(*g) * hypot(*s)) for g, s in known if hypot(*g) and hypot(*s)]
    ratio = seen / given
    if along and median(along) > 0.95 and not 0.67 < ratio < 1.5:
        factor = f"{ratio:.3g} times too short" if ratio > 1 else f"{1 / ratio:.3g} times too long"
        return f"the vectors are {factor}: about {given:.3g} px where the picture moves by {seen:.3g} px"
    return f"'motion' does not explain the albedo: about {given:.3g} px long where the picture moves by {seen:.3g} px"
