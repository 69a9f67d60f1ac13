"""What one frame is rendered in: rays, the channels without noise, radiance, and frames with an open shutter."""
