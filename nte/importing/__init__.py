"""Import of clips from other producers: EXR sequences of any engine, Blender, noisebase."""
