"""Denoiser of files: reads a clip or loose frames, writes linear OpenEXR files, pictures and a video."""
