"""What can be chosen of the filter, and which choices are the paper's."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from nte.errors import NteError
from nte.options import Allowed, Count, NotNegative, Options


@dataclass(frozen=True)
class MotionBlurOptions(Options, name="motion_blur"):
    """Options of motion blur; the defaults are what docs/motion_blur.md measures to be better than preset `paper`.

    prefilter, history: whether those steps run. steps: of the second stage, `fixed` as in the original à-trous
    transform. stretch: of its scaled steps. iterations: of the reprojection, 1 or more. accept, drop: ‖δ‖ below and
    above which it ends, px. fetch: history between pixels, or through the first stage's 5×5 `kernel`. static: where
    history of what does not move is fetched. weight: of history, where the current frame has 1. angle: `naive` averages
    directions in [0°, 360°). factor: of the composition, the share of moving samples, of all or weighted by the way
    they take. beta_a, beta_l: β of the weight. near, jitter: px, of the pre-filter. depth: share of the depth from
    which something is behind. shutter: its open share of the frame, in (0, 1]; 0: as each
    frame says (`Frame.shutter`, which clips have), 1 where it says nothing.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "prefilter": True, "near": 2.5, "jitter": 1.5, "beta_a": 1.0, "beta_l": 10.0, "stretch": 1.0,
            "weight": 1.0, "fetch": "kernel", "static": "reprojected", "factor": "share",
        }
    }  # fmt: skip

    prefilter: bool = False
    history: bool = True
    steps: Literal["scaled", "fixed"] = "scaled"
    iterations: Count = 2
    angle: Literal["relative", "naive"] = "relative"
    factor: Literal["weighted", "share"] = "weighted"
    static: Literal["place", "reprojected"] = "place"
    fetch: Literal["tent", "kernel"] = "tent"
    beta_a: NotNegative = 0.0
    beta_l: NotNegative = 0.0
    stretch: NotNegative = 0.5
    near: NotNegative = 0.5
    jitter: NotNegative = 0.5
    weight: NotNegative = 0.5
    accept: float = 0.5
    drop: float = 8.0
    depth: NotNegative = 0.05
    shutter: Annotated[
        float, Allowed("the open share of the frame, in (0, 1], or 0, as each frame says", lambda x: 0 <= x <= 1)
    ] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.accept <= self.drop:
            raise NteError(
                f"{self.name}: accept is {self.accept} and drop {self.drop}, expected 0 < accept <= drop, px"
            )
