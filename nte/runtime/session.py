"""The runtime of exported models, without PyTorch: OnnxDenoiser("model.onnx") is a denoiser like any other."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnxruntime

from nte.denoiser import Denoiser, Result, require_extras
from nte.errors import NteError
from nte.frames.channels import COMPONENTS, width_of
from nte.frames.clip import Pixels
from nte.frames.frame import Frame
from nte.recurrence import DENOISED, FORWARD, NetworkState, begin, hand_on
from nte.runtime.description import METADATA_KEY, read_description, recurrent_of, require_seal
from nte.runtime.weights import require_finite_weights

Provider = str | tuple[str, dict[str, str]]


class OnnxDenoiser(Denoiser):
    """An exported model as a denoiser: takes frames of NumPy arrays or PyTorch tensors, and returns the same kind.

    providers: ONNX Runtime execution providers, best first, by name or as (name, options); None takes the CPU. threads:
    number of CPU threads; 0 lets ONNX Runtime choose. profile: a folder, to which ONNX Runtime writes the times of the
    graph's operators at `end_profiling`. Raises NteError for a file that is missing, no ONNX model,
    damaged or not exported by nte, and for a provider that is not available.
    """

    def __init__(
        self, path: Path | str, providers: Sequence[Provider] | None = None, threads: int = 0,
        profile: Path | None = None,
    ) -> None:  # fmt: skip
        self.path, self._threads = Path(path), threads
        if not self.path.is_file():
            raise NteError(f"{path}: does not exist; expected an .onnx file made by nte export")
        require_seal(self.path)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        if profile is not None:
            options.enable_profiling, options.profile_file_prefix = True, str(profile / "profile")
        options.log_severity_level = 3  # errors only: the runtime warns about its own graph rewriting
        chosen = self._providers = list(providers or ["CPUExecutionProvider"])
        available = onnxruntime.get_available_providers()
        names = [provider if isinstance(provider, str) else provider[0] for provider in chosen]
        unknown = [name for name in names if name not in available]
        if unknown:
            raise NteError(f"provider '{unknown[0]}' is not available; there are {', '.join(available)}")
        try:
            self._session = onnxruntime.InferenceSession(str(self.path), options, providers=chosen)
        except Exception as error:  # ONNX Runtime raises classes of its own that share no public base
            raise NteError(f"{path}: not a readable ONNX model: {str(error).splitlines()[0]}") from error
        require_finite_weights(self.path)
        self._inputs = {i.name: i.shape for i in self._session.get_inputs()}
        self._outputs = [o.name for o in self._session.get_outputs()]
        text = self._session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        self.info = read_description(self.path, text, self._inputs, self._outputs)
        self._recurrent = recurrent_of(self.info, self._inputs)
        self.needs: tuple[str, ...] = tuple(self.info["needs"])
        self.optional = tuple(self.info["optional"])
        self.target = self.info["target"]
        self.prior: str = self.info.get("prior", "")  # the denoiser that makes the channel `prior`
        kept = {"image", *(tensor.source for tensor in self._recurrent.values())}
        self.components = tuple(name for name in COMPONENTS if DENOISED + name in self._outputs)
        self._extras = {DENOISED + name: name for name in self.components}  # output → extra, if they differ
        self.extras = tuple(self._extras.get(name, name) for name in self._outputs if name not in kept)

    def step(
        self, frame: Frame, state: NetworkState | None, extras: tuple[str, ...] = ()
    ) -> tuple[Result, NetworkState]:
        """Denoise one frame; return the result and the state for the next frame.

        state: the state that the previous step returned; None starts a sequence. extras: names of further outputs of
        the graph. The graph scatters a missing previous_forward_motion from motion and depth. Raises NteError for a
        channel that is missing or has the wrong type or shape, for unknown extras, and for a size that changes within
        a sequence.
        """
        require_extras(self, extras, self.path)
        arrays = frame.numpy()
        feed = {name: self._checked(arrays, name) for name in self.needs}
        if FORWARD in self._inputs:  # the graph makes it where it is NaN everywhere
            given = FORWARD in arrays
            feed[FORWARD] = self._checked(arrays, FORWARD) if given else np.full_like(feed["motion"], np.nan)
        state, reset = begin(arrays, state, self._recurrent, lambda shape: np.zeros(shape, np.float32), self._inputs)
        feed |= {"reset": reset, **state.scalars.known(), **state.tensors}
        sources = (tensor.source for tensor in self._recurrent.values())
        outputs = {name: DENOISED + name if name in self.components else name for name in extras}
        kept = (name for name in sources if name in self._outputs)
        wanted = list(dict.fromkeys(["image", *kept, *outputs.values()]))
        used = {name: array for name, array in feed.items() if name in self._inputs}
        made = dict(zip(wanted, self._session.run(wanted, used), strict=True))
        result = Result(made["image"], {name: made[output] for name, output in outputs.items()}).like(frame)
        return result, hand_on(state, self._recurrent, feed | made)

    def profiled(self, folder: Path) -> "OnnxDenoiser":
        """Load the model once more, with the same providers and threads, to be profiled into `folder`."""
        return OnnxDenoiser(self.path, self._providers, self._threads, folder)

    def end_profiling(self) -> str:
        """Write ONNX Runtime's profile (JSON), and return its path. Only for a model that is profiled."""
        return str(self._session.end_profiling())

    def _checked(self, frame: Frame, name: str) -> Pixels:
        array = frame[name]
        if array.dtype != np.float32:
            raise NteError(f"frame {frame.index}: channel '{name}' is {array.dtype}, expected float32")
        expected = width_of(name)
        if array.shape[1] != expected:
            raise NteError(f"frame {frame.index}: channel '{name}' is {array.shape}, expected (N, {expected}, H, W)")
        if min(frame.size) < self.info["smallest"]:
            raise NteError(f"frame {frame.index}: size {frame.size}, expected at least {self.info['smallest']} pixels")
        return np.ascontiguousarray(array)
