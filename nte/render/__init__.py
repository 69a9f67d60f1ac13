"""Rendering training and test clips with Mitsuba: `nte render RECIPE.yaml --out DIR`.

Six layers, each of which knows only those before it. `world` says what there is to render and when, in NumPy alone;
`scenes` makes worlds of it. `engine` puts a world, or a Mitsuba XML file, into Mitsuba; `engine.backend` is the only
place that may import Mitsuba, because it has to choose the LLVM first. `passes` render radiance and the channels
without noise, `components` the light components with their vectors, and `recipes` make folders of clips of them all.
"""
