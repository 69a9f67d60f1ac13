"""View transforms: from linear radiance to the colours of a picture."""

import os

import numpy as np

from nte.errors import NteError, needs_extra
from nte.frames.show import Pixels, View, display
from nte.frames.srgb import encode_srgb

# Linear light with the primaries of Rec. 709 by its names in OpenColorIO's built-in configurations and in Blender's.
_LINEAR = ("Linear Rec.709 (sRGB)", "lin_rec709", "Linear Rec.709")


def standard(radiance: Pixels, exposure: float = 1.0) -> Pixels:
    """Transform radiance (3, H, W) by the sRGB curve alone; what is brighter than 1 is cut off."""
    return encode_srgb(np.clip(radiance * np.float32(exposure), 0, 1)).astype(np.float32)


_OURS: dict[str, View] = {"nte": display, "standard": standard}


def find_view(name: str) -> View:
    """Find a view transform: `nte` (exposure, x/(1+x), sRGB), `standard` (sRGB), or one of OpenColorIO, such as AgX.

    OpenColorIO's configuration is the one that the variable OCIO names, or else the library's default. Upper and lower
    case are alike. Raises NteError for a name that is not there, and for a configuration that cannot be read.
    """
    return _OURS.get(name.lower()) or _from_opencolorio(name)


def _from_opencolorio(name: str) -> View:
    try:
        import PyOpenColorIO as ocio  # noqa: N813
    except ImportError as error:
        raise needs_extra("view", f"the view '{name}'", error) from error
    where = os.environ.get("OCIO") or "ocio://default"
    try:
        config = ocio.Config.CreateFromFile(where)
        screen = config.getDefaultDisplay()
        views = list(config.getViews(screen))
        found = {view.lower(): view for view in views}.get(name.lower())
        if found is None:
            raise NteError(
                f"no view '{name}' in {where}, which has {', '.join(views)}; nte has {', '.join(_OURS)}: choose one, "
                "or set OCIO to another config.ocio (Blender's, in its datafiles/colormanagement, has AgX and Filmic)"
            )
        linear = next((space for space in _LINEAR if config.getColorSpace(space)), ocio.ROLE_SCENE_LINEAR)
        transform = ocio.DisplayViewTransform(src=linear, display=screen, view=found)
        processor = config.getProcessor(transform).getDefaultCPUProcessor()
    except (ocio.Exception, ocio.ExceptionMissingFile) as error:
        raise NteError(f"{where}: OpenColorIO cannot use it: {' '.join(str(error).split()):.200}") from error

    def view(radiance: Pixels, exposure: float = 1.0) -> Pixels:
        pixels = np.ascontiguousarray(radiance.transpose(1, 2, 0) * np.float32(exposure), np.float32)
        processor.applyRGB(pixels)  # in place
        return pixels.transpose(2, 0, 1).clip(0, 1)

    return view
