"""Running an exported model without PyTorch: OnnxDenoiser("model.onnx") is a denoiser like any other."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import onnxruntime

from nte.denoiser import Denoiser, Result, check_extras, check_size
from nte.errors import NteError
from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.frames.scalars import known_scalars
from nte.runtime.description import METADATA_KEY, STATE, check_seal, read_description

Pixels = npt.NDArray[np.float32]
Provider = str | tuple[str, dict[str, str]]


class OnnxState(NamedTuple):
    """The recurrent inputs of the next frame, and the sequence's scalars."""

    tensors: dict[str, Pixels]
    exposure: Pixels  # (N,), NaN until there was light
    depth_scale: Pixels  # (N,), NaN until a surface was seen

    def begun(self, frame: Frame, reset: Pixels) -> "OnnxState":
        """With the exposure and depth scale of sequences that start here, or that had none yet."""
        starts = [(reset > 0) | np.isnan(carried) for carried in self[1:]]
        if not np.any(starts):
            return self
        own = zip(starts, known_scalars(frame), self[1:], strict=True)
        return OnnxState(self.tensors, *(np.where(start, scalar, carried) for start, scalar, carried in own))


class OnnxDenoiser(Denoiser):
    """An exported model with its state handling. Takes and returns NumPy (or what the frame has).

    providers: ONNX Runtime execution providers, best first, by name or as (name, options); None: the CPU. threads: 0
    lets ONNX Runtime choose. Raises NteError for a file that is missing, no ONNX model, damaged, or not
    exported by nte.
    """

    def __init__(self, path: Path | str, providers: Sequence[Provider] | None = None, threads: int = 0) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise NteError(f"{path}: does not exist; expected an .onnx file made by nte export")
        check_seal(self.path)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3  # warnings of the runtime about its own graph rewriting
        chosen = list(providers or ["CPUExecutionProvider"])
        available = onnxruntime.get_available_providers()
        names = [provider if isinstance(provider, str) else provider[0] for provider in chosen]
        unknown = [name for name in names if name not in available]
        if unknown:
            raise NteError(f"provider '{unknown[0]}' is not available; there are {', '.join(available)}")
        try:
            self._session = onnxruntime.InferenceSession(str(self.path), options, providers=chosen)
        except Exception as error:  # ONNX Runtime raises classes of its own that share no public base
            raise NteError(f"{path}: not a readable ONNX model: {str(error).splitlines()[0]}") from error
        self._inputs = {i.name: i for i in self._session.get_inputs()}
        self.extras = tuple(o.name for o in self._session.get_outputs())
        text = self._session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        self.info = read_description(self.path, text, self.extras)
        self.needs: tuple[str, ...] = tuple(self.info["needs"])
        self.optional = tuple(self.info["optional"])
        self.target = self.info["target"]

    def step(self, frame: Frame, state: OnnxState | None, extras: tuple[str, ...] = ()) -> tuple[Result, OnnxState]:
        """Denoise one frame; None starts a sequence. extras: further outputs of the graph.

        Raises NteError for a channel that is missing or has the wrong type or shape, and for a size that
        changes within a sequence.
        """
        check_extras(self, extras, self.path)
        arrays = frame.numpy()
        feed = {name: self._checked(arrays, name) for name in self.needs}
        if "previous_forward_motion" in self._inputs:
            feed["previous_forward_motion"] = (
                self._checked(arrays, "previous_forward_motion") if "previous_forward_motion" in arrays
                else scatter_forward_motion(feed["motion"], feed["depth"])
            )  # fmt: skip
        reset = np.asarray(np.zeros(frame.batch) if arrays.reset is None else arrays.reset, np.float32)
        if state is None:
            reset = np.ones(frame.batch, np.float32)
            state = self._begin(frame)
        check_size(frame, state.tensors["history"])
        state = state.begun(arrays, reset)
        scalars = {name: np.nan_to_num(getattr(state, name), nan=1.0) for name in ("exposure", "depth_scale")}
        feed |= {"reset": reset, **scalars, **state.tensors}
        kept: dict[str, str] = self.info["state"]
        wanted = list(dict.fromkeys(["image", *(n for n in kept.values() if n in self.extras), *extras]))
        outputs = dict(zip(wanted, self._session.run(wanted, self._only_inputs(feed)), strict=True))
        following = {name: outputs[source] if source in outputs else feed[source] for name, source in kept.items()}
        result = Result(outputs["image"], {name: outputs[name] for name in extras}).like(frame)
        return result, OnnxState(following, state.exposure, state.depth_scale)

    def _only_inputs(self, feed: dict[str, Pixels]) -> dict[str, Pixels]:
        """What the graph still has as an input: the exporter drops those that a network does not use."""
        return {name: array for name, array in feed.items() if name in self._inputs}

    def _begin(self, frame: Frame) -> OnnxState:
        zeros = {name: np.zeros((frame.batch, c, *frame.size), np.float32) for name, c in STATE.items()}
        scalar = np.ones(frame.batch, np.float32)
        return OnnxState(zeros, scalar, scalar)

    def _checked(self, frame: Frame, name: str) -> Pixels:
        array = frame[name]
        if array.dtype != np.float32:
            raise NteError(f"frame {frame.index}: channel '{name}' is {array.dtype}, expected float32")
        expected = len(CHANNELS[name].components)
        if array.shape[1] != expected:
            raise NteError(f"frame {frame.index}: channel '{name}' is {array.shape}, expected (N, {expected}, H, W)")
        if min(frame.size) < self.info["smallest"]:
            raise NteError(f"frame {frame.index}: size {frame.size}, expected at least {self.info['smallest']} pixels")
        return np.ascontiguousarray(array)


def scatter_forward_motion(motion: Pixels, depth: Pixels) -> Pixels:
    """previous_forward_motion (N, 2, H, W) from −motion scattered to x + motion; NaN where nobody arrives.

    depth (N, 1, H, W), 0 = infinitely far: the nearest surface wins, of equally near ones the last pixel.
    The same as nte.motion.geometric.scatter_forward_motion, which needs PyTorch.
    """
    batch, _, height, width = motion.shape
    y, x = np.indices((height, width), np.float32) + np.float32(0.5)
    forward = np.full((batch, 2, height * width), np.nan, np.float32)
    for n in range(batch):
        px, py = x + motion[n, 0], y + motion[n, 1]
        valid = (px >= 0) & (px <= width) & (py >= 0) & (py <= height)
        column = np.minimum(px[valid].astype(np.int64), width - 1)
        row = np.minimum(py[valid].astype(np.int64), height - 1)
        far = np.where(depth[n, 0][valid] > 0, depth[n, 0][valid], np.inf)
        # NumPy assigns in order, so the last of several writes to a pixel stays: nearest last.
        order = np.argsort(-far, kind="stable")
        forward[n][:, (row * width + column)[order]] = -motion[n][:, valid][:, order]
    return forward.reshape(motion.shape)
