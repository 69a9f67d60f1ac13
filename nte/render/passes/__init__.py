"""The passes of a frame: rays, the noise-free channels, radiance, and frames with an open shutter."""
