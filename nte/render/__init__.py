"""Rendering of training and test clips with Mitsuba: `nte render RECIPE.yaml --out DIR`.

The package has six layers, and each layer uses only those before it. `world` describes what there is to render and
when, in NumPy alone. `scenes` builds procedural worlds. `engine` puts a world, or a Mitsuba XML file, into Mitsuba;
`engine.backend` is the only module that may import Mitsuba, because it must choose the LLVM first. `passes` render
radiance and the noise-free channels, `components` render the light components with their vectors, and `recipes`
combine all of them into folders of clips.
"""

import sys
from pathlib import Path
from types import ModuleType

from nte.errors import needs_extra


class _Package(ModuleType):
    """The package as a function: `nte.render(recipe, out)`."""

    def __call__(
        self, recipe: Path | str, out: Path | str, jobs: int = 1, force: bool = False, progress: bool = True,
        scheduler: str | None = None,
    ) -> list[Path]:  # fmt: skip
        """Render every clip of a recipe below the folder `out` and return the clips' folders.

        Continue where an earlier run stopped: whole frames are kept. The files have the same bytes for any number of
        jobs, workers and interruptions.

        jobs: number of processes; a single process already uses all cores. force: replace the clips of another recipe.
        progress: show progress on stderr. scheduler: address of a Dask scheduler, whose workers render instead; they
        must see `out` under the same path. Raises NteError for a faulty recipe, a folder that holds other files, or a
        full disk.

        >>> [folder] = nte.render("recipe.yaml", "data/spheres", progress=False)  # one clip of 16×16 pixels
        >>> nte.Clip(folder).frame(0)["reference"].shape
        (1, 3, 16, 16)
        """
        try:
            from nte.render.recipes.clips import render_recipe
        except ImportError as error:
            raise ImportError(str(needs_extra("render", "rendering", error)), name=error.name) from error

        return render_recipe(recipe, out, jobs, force, progress, scheduler)


sys.modules[__name__].__class__ = _Package
