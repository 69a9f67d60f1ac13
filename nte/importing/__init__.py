"""Clips from other producers: EXR sequences of any engine, Blender, noisebase (datasets/IMPORT.md)."""
