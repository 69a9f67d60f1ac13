"""Options of the filter for motion blur, and those that are the paper's (preset `paper`)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from nte.errors import NteError
from nte.options import Allowed, Count, NotNegative, Options


@dataclass(frozen=True)
class MotionBlurOptions(Options, name="motion_blur"):
    """Options of the filter for motion blur; the defaults measure better than preset `paper`.

    prefilter, history: whether those steps run. steps: of the second stage: `scaled` by the motion, or `fixed` as in
    the original à-trous transform. stretch: factor of the scaled steps. iterations: of the search for history, 1 or
    more. accept, drop: ‖δ‖ in px below which that search accepts, and above which it gives up. fetch: history
    interpolated between pixels (`tent`), or through the first stage's 5×5 `kernel`. static: fetch the history of static
    samples at the pixel's own `place`, or `reprojected` as that of moving ones. weight: of history, relative to 1 for
    the current frame. angle: `naive` averages directions in [0°, 360°). factor: of the composition: the plain `share`
    of moving samples, or the share `weighted` by their paths. beta_a, beta_l: β of the weight, for angle and length.
    near, jitter: px, of the pre-filter. depth: relative depth difference from which something is behind. shutter: the
    open share of the frame, in (0, 1]; 0 takes the share of each frame (`Frame.shutter`, which clips have), or 1 if the
    frame has none.
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
