"""Rendering training and test clips with Mitsuba: `nte render RECIPE.yaml --out DIR`.

Six layers, each of which knows only those before it. `world` says what there is to render and when, in NumPy alone;
`scenes` makes worlds of it. `engine` puts a world, or a Mitsuba XML file, into Mitsuba; `engine.backend` is the only
place that may import Mitsuba, because it has to choose the LLVM first. `passes` render radiance and the channels
without noise, `components` the light components with their vectors, and `recipes` make folders of clips of them all.
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

        Continues where an earlier run stopped: whole frames are kept, and the files have the same bytes for any number
        of jobs, workers and interruptions. jobs: processes; one uses all cores already. force: replace another recipe's
        clips. progress: show it on stderr. scheduler: address of a Dask cluster that renders instead, whose workers see
        `out`. Raises NteError for a faulty recipe, a folder with other files in it, a full disk.

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
