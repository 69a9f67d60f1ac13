"""What pairs of consecutive frames tell of vectors, and what right vectors tell of other channels."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

import torch

from nte.checking.cameras import Prediction, prediction
from nte.checking.cells import cell_votes
from nte.checking.cuts import judge_frames, unlike_before
from nte.checking.forward import Returns, judge_returns, returns
from nte.checking.judge import confirms
from nte.checking.objects import object_votes
from nte.checking.order import Order, depth_order, judge_order
from nte.checking.residuals import Mean, add_errors, visible_in_both
from nte.checking.sky import SkyMotion, judge_sky, sky_motion
from nte.checking.spaces import Spaces, changed_alike, judge_spaces
from nte.checking.still import Stillness, stillness
from nte.checking.travels import Changes, changes, judge_changes
from nte.checking.units import ONCE, judge_units, unit_of
from nte.checking.values import Finding
from nte.checking.votes import Votes
from nte.frames.frame import Frame
from nte.motion.geometric import frame_vectors


@dataclass
class PairTally:
    """Results collected from the pairs of consecutive frames of a clip that has motion."""

    votes: dict[int, Votes] = field(default_factory=dict)  # of each frame
    still: list[Stillness] = field(default_factory=list)
    orders: list[Order] = field(default_factory=list)
    skies: list[SkyMotion] = field(default_factory=list)
    spaces: list[Spaces] = field(default_factory=list)
    changes: list[Changes] = field(default_factory=list)
    predictions: list[Prediction] = field(default_factory=list)
    returns: list[Returns] = field(default_factory=list)
    units: dict[int, float] = field(default_factory=dict)  # of each frame that tells
    errors: dict[tuple[str, str, str], Mean] = field(default_factory=lambda: defaultdict(Mean))
    disoccluded: Mean = field(default_factory=Mean)
    invalid: Mean = field(default_factory=Mean)
    telling: tuple[int, int] = (0, 1)  # most disoccluded pixels, and the frame that has them

    def add(self, previous: Frame, current: Frame, vote: bool) -> None:
        """Add two consecutive frames that have motion. vote: collect votes on the vectors as well, which costs more."""
        dual = frame_vectors(current, previous.get("depth"))
        everywhere = torch.ones_like(dual.valid)
        self.disoccluded.add(dual.disoccluded.float(), everywhere)
        self.invalid.add((~dual.valid).float(), everywhere)
        if (hidden := int(dual.disoccluded.sum())) > self.telling[0]:
            self.telling = hidden, current.index
        add_errors(self.errors, previous, current, dual)
        if not vote:
            return
        in_both = visible_in_both(previous, current, dual)
        self.still.append(stillness(previous, current))
        self.changes.append(changes(previous, current, dual.valid & ~dual.disoccluded, in_both))
        self.spaces.append(changed_alike(previous, current, in_both))
        if (of_sky := sky_motion(previous, current)) is not None:
            self.skies.append(of_sky)
        if (predicted := prediction(previous, current)) is not None:
            self.predictions.append(predicted)
        if found := returns(previous, current):
            self.returns.append(found)
        if "depth" in current and "depth" in previous:
            self.orders.append(depth_order(previous, current))
            if (ratio := unit_of(previous, current)) is not None:
                self.units[current.index] = ratio
        votes = Votes()
        if "albedo" in current:
            votes.add(cell_votes(previous, current))
        if "instance" in current:
            votes.add(object_votes(previous, current))
        self.votes[current.index] = votes

    def _rescaled(self) -> set[int]:
        return {frame for frame, ratio in self.units.items() if not 1 / ONCE < ratio < ONCE}

    def total_votes(self) -> Votes:
        """Add up the votes of all frames."""
        total = Votes()
        for votes in self.votes.values():
            total.add(votes)
        return total

    def judge_units(self) -> list[Finding]:
        """List what changes of the unit of depth are found; after a cut one is found by chance."""
        cuts = set(unlike_before(self.votes)) - self._rescaled()
        one_shot = {frame: ratio for frame, ratio in self.units.items() if frame not in cuts}
        confirmed = [ratio for frame, ratio in one_shot.items() if confirms(self.votes[frame])]
        return list(judge_units(list(one_shot.values()), confirmed))

    def judge(self) -> Iterator[Finding]:
        """Yield what right vectors say of other channels."""
        yield from judge_frames(self.votes, self._rescaled())
        yield from judge_order(self.orders)
        yield from judge_sky(self.skies)
        yield from (alike := list(judge_spaces(self.spaces)))
        explained = {finding.channel for finding in alike}  # a space that moves along changes along motion, too
        yield from (forth := list(judge_returns(self.returns, self.total_votes())))
        if not any(finding.fault for finding in forth):  # which say what was hidden, and compare other surfaces
            yield from (finding for finding in judge_changes(self.changes) if finding.channel not in explained)
