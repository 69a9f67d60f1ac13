"""Bursts of photographs: read, aligned and merged into one picture with less noise."""
