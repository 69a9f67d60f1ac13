"""The runtime of exported models, without PyTorch: OnnxDenoiser("model.onnx") is a denoiser like any other."""

from pathlib import Path

import numpy as np

from nte.denoiser import Denoiser, Result, require_extras
from nte.errors import NteError
from nte.frames.channels import COMPONENTS, width_of
from nte.frames.clip import Pixels
from nte.frames.frame import Frame
from nte.recurrence import DENOISED, FORWARD, NetworkState, begin, hand_on
from nte.runtime.description import METADATA_KEY, read_description, recurrent_of, require_seal
from nte.runtime.engine import Engine, Spent, Value
from nte.runtime.onnx_engine import OnnxRuntime
from nte.runtime.onnx_file import metadata_of
from nte.runtime.providers import PROVIDERS, OnnxOptions, require_installed
from nte.runtime.weights import require_finite_weights


class OnnxDenoiser(Denoiser):
    """An exported model as a denoiser: takes frames of NumPy arrays or PyTorch tensors, and returns the same kind.

    options: where it runs; None takes the CPU. profiled: take the times of the graph's operators, for `profile`. The
    state of a sequence stays in the provider's memory. Several sequences may share a denoiser, also on several threads.
    Raises NteError for a file that is missing, no ONNX model, damaged or not exported by nte, and for a provider that
    is not installed or does not start.
    """

    def __init__(self, path: Path | str, options: OnnxOptions | None = None, *, profiled: bool = False) -> None:
        self.path, self.options = Path(path), options or OnnxOptions()
        if not self.path.is_file():
            found = "is no file" if self.path.exists() else "does not exist"
            raise NteError(f"{path}: {found}; expected an .onnx file made by nte export")
        require_seal(self.path)
        require_finite_weights(self.path)
        self._engine = _engine_for(self.path, self.options, profiled)
        self._inputs, self._outputs = self._engine.inputs, self._engine.outputs
        said = metadata_of(self.path, METADATA_KEY)
        self.info = read_description(self.path, said, self._inputs, self._outputs)
        self._recurrent = recurrent_of(self.info, self._inputs)
        self.needs: tuple[str, ...] = tuple(self.info["needs"])
        self.optional = tuple(self.info["optional"])
        self.target = self.info["target"]
        self.label = self.path.stem
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
        feed, state = self.fed(frame, state)
        sources = {tensor.source for tensor in self._recurrent.values()}
        feed |= {name: self._engine.keep(feed[name]) for name in sources if name in feed}
        outputs = {name: DENOISED + name if name in self.components else name for name in extras}
        shown = list(dict.fromkeys(["image", *outputs.values()]))
        used = {name: value for name, value in feed.items() if name in self._inputs}
        made = self._engine.run(used, shown, [name for name in self._outputs if name in sources.difference(shown)])
        both = {name: self._engine.keep(made[name]) for name in sources.intersection(shown)}  # `shown` is the caller's
        after = hand_on(state, self._recurrent, feed | made | both)
        result = Result(made["image"], {name: made[output] for name, output in outputs.items()}).like(frame)
        return result, after

    def fed(self, frame: Frame, state: NetworkState | None) -> tuple[dict[str, Value], NetworkState]:
        """Return what a frame brings to the graph, and the state, which begins where it is None.

        Raises NteError as `step` does.
        """
        arrays = frame.numpy()
        feed: dict[str, Value] = {name: self._checked(arrays, name) for name in self.needs}
        if FORWARD in self._inputs:  # the graph makes it where it is NaN everywhere
            given = FORWARD in arrays
            feed[FORWARD] = self._checked(arrays, FORWARD) if given else np.full_like(feed["motion"], np.nan)
        state, reset = begin(arrays, state, self._recurrent, lambda shape: np.zeros(shape, np.float32), self._inputs)
        return feed | {"reset": reset, **state.scalars.known(), **state.tensors}, state

    def profiled(self) -> "OnnxDenoiser":
        """Load the model once more, with the same options, to be profiled."""
        return OnnxDenoiser(self.path, self.options, profiled=True)

    def profile(self) -> list[Spent]:
        """End the profile; return for each frame so far its operators: names in the graph, and milliseconds.

        Only for a model that is profiled.
        """
        return self._engine.profile()

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


def _engine_for(path: Path, options: OnnxOptions, profiled: bool) -> Engine:
    """Load the graph at `path` where the options say. Raises NteError for a provider that is not installed."""
    require_installed(options.provider)
    if PROVIDERS[options.provider].name:
        return OnnxRuntime(path, options, profiled)
    from nte.runtime.openvino_engine import OpenVino

    return OpenVino(path, options, profiled)
