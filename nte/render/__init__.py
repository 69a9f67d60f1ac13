"""Rendering training and test clips with Mitsuba: `nte render RECIPE.yaml --out DIR`.

recipe.py says what to render, clips.py renders it into the folder that output.py looks after. A scene
(scene.py, made by scenes/) is NumPy only; stage.py puts it into Mitsuba at a time; integrator.py renders the
radiance and gbuffer.py, with rays.py, the channels without noise. backend.py is the only place that may import
Mitsuba, because it has to choose the LLVM first.
"""
